"""Policies: policy files, the policies in them, and the baselines that they are compared with.

This package itself needs only numpy, so that a host with a real hand runs a trained policy without
a simulator:

```python
from hpac_gym.policies import LearnedPolicy, read_policy

policy = LearnedPolicy.of(read_policy("policy.hpac"))
action, state = policy.predict(observation)          # shape (6,), −1…1; begins an episode
action, state = policy.predict(observation, state)   # its next step
```

`hpac_gym.policies.loading` loads a policy for an environment by name or file; this module,
`hpac_gym.policies.made_for` and `hpac_gym.policies.baselines` need `hpac_gym.envs`."""

from hpac_gym.errors import PolicyError
from hpac_gym.policies.closure import Closures
from hpac_gym.policies.policy import LearnedPolicy, Policy
from hpac_gym.policies.policy_file import Actor, PolicyFile, read_policy, write_policy

__all__ = [
    "Actor",
    "Closures",
    "LearnedPolicy",
    "Policy",
    "PolicyError",
    "PolicyFile",
    "read_policy",
    "write_policy",
]
