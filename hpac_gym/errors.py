"""The exceptions of hpac_gym: one tree, each also a built-in type.

Messages name the value, the bound and the unit, so that a command line can print them as they are.
"""


class HpacError(Exception):
    """Base of every error that this library raises on purpose."""


class ShapeError(HpacError, ValueError):
    """An array has the wrong shape, or holds something that is not a finite number."""


class WorkspaceError(HpacError, ValueError):
    """A joint, synergy, servo or action value lies outside of what the hand can do."""


class ParameterError(HpacError, ValueError):
    """A hand parameter or a parameter file is missing, malformed or unphysical."""


class EpisodeError(HpacError, RuntimeError):
    """A call that does not fit the state of an environment: before reset, after the end, or after close."""
