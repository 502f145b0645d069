"""Episodes from beginning to end."""


def run(env, policy, setup=None, seed=0) -> tuple[list[dict], float]:
    """One episode: the infos of its steps, and its return."""
    observation, _ = env.reset(seed=seed, options={"setup": setup} if setup else None)
    policy.reset()
    infos, total, over = [], 0.0, False
    while not over:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        infos.append(info)
        total += reward
        over = terminated or truncated
    return infos, total
