"""What one sees of a training: the bar, the learning curve, TensorBoard; and when it saves and when it ends."""

import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from tqdm import tqdm

from agents.learning_curve import CURVE, append_row

ROW_EVERY = 1_000  # decisions
LINE_EVERY_S = 30.0  # where there is no terminal to draw a bar on


class Progress(BaseCallback):
    """Watches a training: shows it, writes its learning curve, saves it at intervals and stops it in time.

    Returns and successes are means over the last ``window`` episodes, up to 100 of them, actions explored.
    """

    def __init__(
        self, folder: Path, total_steps: int, save: Callable[[float], None], save_every: int,
        seconds_before: float = 0.0, time_limit: float = float("inf"), started: float | None = None,
    ) -> None:  # fmt: skip
        super().__init__()
        self.stopped_by: str | None = None
        self._curve, self._total_steps = folder / CURVE, total_steps
        self._save, self._save_every = save, save_every
        self._seconds_before, self._time_limit = seconds_before, time_limit
        self._started = time.monotonic() if started is None else started
        self._term_sums: list[defaultdict[str, float]] = []
        self._terms: defaultdict[str, list[float]] = defaultdict(list)

    @property
    def seconds(self) -> float:
        """How long this run has trained so far, its earlier parts included."""
        return self._seconds_before + time.monotonic() - self._started

    def stop(self, reason: str) -> None:
        """End the training after the step that is under way."""
        self.stopped_by = reason

    def _on_training_start(self) -> None:
        self._term_sums = [defaultdict(float) for _ in range(self.model.n_envs)]
        self._first_step, self._next_line = self.num_timesteps, LINE_EVERY_S / 3
        self._next_row = self.num_timesteps + ROW_EVERY
        self._next_save = self.num_timesteps + self._save_every
        self._bar = tqdm(
            total=100, desc="training", disable=not sys.stderr.isatty(), dynamic_ncols=True,
            bar_format="{desc} {percentage:3.0f}% |{bar}| {elapsed} of {remaining} more{postfix}",
        )  # fmt: skip

    def _on_step(self) -> bool:
        self._gather_terms()
        if self.num_timesteps >= self._next_row:
            self._next_row += ROW_EVERY
            append_row(self._curve, self._row())
        if self.num_timesteps >= self._next_save:
            self._next_save += self._save_every
            self._save(self.seconds)
        if time.monotonic() - self._started > self._time_limit:
            self.stop("time limit")
        self._show()
        return self.stopped_by is None

    def _on_rollout_end(self) -> None:
        for name, sums in self._terms.items():
            self.logger.record(f"reward/{name}", np.mean(sums[-100:]))
        self._terms.clear()

    def _on_training_end(self) -> None:
        append_row(self._curve, self._row())
        self._bar.close()

    def _row(self) -> dict[str, float | int]:
        episodes, successes = self.model.ep_info_buffer, self.model.ep_success_buffer
        return {
            "steps": self.num_timesteps,
            "seconds": round(self.seconds, 1),
            "episodes": self.model._episode_num,
            "return_mean": round(float(np.mean([episode["r"] for episode in episodes])), 4) if episodes else float("nan"),
            "success_rate": round(float(np.mean(successes)), 4) if successes else float("nan"),
            "window": len(successes),
        }

    def _gather_terms(self) -> None:
        for info, done, sums in zip(self.locals["infos"], self.locals["dones"], self._term_sums, strict=True):
            for name, value in info.get("reward_terms", {}).items():
                sums[name] += value
            if done:
                for name, total in sums.items():
                    self._terms[name].append(total)
                sums.clear()

    def _show(self) -> None:
        elapsed = time.monotonic() - self._started
        by_steps = (self.num_timesteps - self._first_step) / max(1, self._total_steps - self._first_step)
        share = min(1.0, max(by_steps, elapsed / self._time_limit))
        if self._bar.disable and elapsed < self._next_line:
            return
        self._next_line = elapsed + LINE_EVERY_S
        row = self._row()
        rate = (self.num_timesteps - self._first_step) / elapsed
        success = f"{row['success_rate']:.0%} of the last {row['window']}" if row["window"] else "not known yet"
        text = f"{self.num_timesteps:,} steps, {rate:.0f}/s, success {success}"
        if self._bar.disable:
            print(f"training {share:4.0%} {elapsed / 60:5.1f} min, {text}", file=sys.stderr, flush=True)
        else:
            self._bar.set_postfix_str(text, refresh=False)
            self._bar.update(100 * share - self._bar.n)
