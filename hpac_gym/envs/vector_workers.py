"""The processes below `GroupedVectorEnv`, as it sees them: asked all at once, and closed without a trace."""

from __future__ import annotations

import contextlib
import multiprocessing
from collections.abc import Sequence
from itertools import pairwise
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from time import monotonic
from typing import Any

from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import CloudpickleWrapper

from hpac_gym.envs.errors import WorkerError
from hpac_gym.envs.vector_group import Answer, Buffers, EnvFn, Group, serve

CONTEXT: SpawnContext = multiprocessing.get_context("spawn")
"""New processes begin from nothing, so that threads of this one, such as PyTorch's, cannot lock them up."""
CLOSE_SECONDS = 10.0
"""Workers that are asked to close have this long before they are killed [s]."""


def shares(count: int, workers: int) -> list[range]:
    """Which of `count` places each worker takes: neighbours, as equally many as can be."""
    edges = [round(count * worker / workers) for worker in range(workers + 1)]
    return [range(*pair) for pair in pairwise(edges)]


class Workers:
    """One process for each share of the places. They end with this one, whatever ends it.

    Raises:
        WorkerError: A process has ended on its own, here or in a later call.
        Exception: What an environment raised as it was made.
    """

    def __init__(self, env_fn: EnvFn, places: Sequence[range], buffers: Buffers, autoreset_mode: AutoresetMode) -> None:
        self.places = places
        self._pipes: list[Connection] = []
        self.processes: list[SpawnProcess] = []
        self._trouble = ""
        """Why no call can be answered any more."""
        for number, share in enumerate(places):
            ours, its = CONTEXT.Pipe()
            group = Group(CloudpickleWrapper(env_fn), share, buffers, autoreset_mode)
            process = CONTEXT.Process(target=serve, args=(its, group), name=f"hpac_gym worker {number}", daemon=True)
            process.start()
            its.close()
            self._pipes.append(ours)
            self.processes.append(process)
        try:
            self._answers()
        except BaseException as error:
            self.close()
            if isinstance(error, WorkerError):
                error.add_note('A script that makes vector environments keeps its work under: if __name__ == "__main__":')
            raise

    def ask(self, name: str, arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Call a method of every worker's `Group`, each with its own arguments; their values in the order of places.

        Raises:
            WorkerError: A process has ended on its own, or an earlier call was interrupted.
            Exception: What the environment at the lowest place raised, with a note of that place.
        """
        if self._trouble:
            raise WorkerError(self._trouble)
        for number, pipe in enumerate(self._pipes):
            try:
                pipe.send((name, arguments[number]))
            except OSError:
                raise self._lost(number) from None
        return self._answers()

    def _answers(self) -> list[Any]:
        self._trouble = "an earlier call was interrupted: close this vector environment and make a new one"
        answers: list[Answer] = []
        for number, pipe in enumerate(self._pipes):
            try:
                answers.append(pipe.recv())
            except (EOFError, OSError):
                raise self._lost(number) from None
        self._trouble = ""
        for answer in answers:
            if answer.error is not None:
                answer.error.add_note(f"raised in environment {answer.place}; there:\n{answer.trace}")
                raise answer.error
        return [value for answer in answers for value in answer.value or ()]

    def _lost(self, number: int) -> WorkerError:
        share, process = self.places[number], self.processes[number]
        process.join(CLOSE_SECONDS)
        self._trouble = (
            f"worker {number}, with environments {share.start} to {share.stop - 1}, ended with exit code {process.exitcode}: "
            "close this vector environment and make a new one"
        )
        return WorkerError(self._trouble)

    def close(self) -> None:
        """End the processes, those that do not listen by force."""
        for pipe in self._pipes:
            with contextlib.suppress(OSError):  # that worker is gone
                pipe.send(("close", ()))
        deadline = monotonic() + CLOSE_SECONDS
        for process in self.processes:
            process.join(max(0.0, deadline - monotonic()))
            if process.is_alive():
                process.kill()
                process.join()
        for pipe in self._pipes:
            pipe.close()
