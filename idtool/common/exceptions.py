"""Errors a user can act on.

A message reads ``<file or key>: <what is wrong and what to do>`` and fits one line; the command line prints it
behind ``error:`` and exits with code 2.
"""

from __future__ import annotations

from idtool.common.names import without_secrets


class IdtoolError(Exception):
    """Base of every error that idtool raises on purpose.

    Parameters
    ----------
    where
        The file or configuration key the error is about.
    what
        What is wrong with it and what to do.
    """

    def __init__(self, where: object, what: str) -> None:
        self.where = _one_line(without_secrets(str(where)))
        self.what = _one_line(" ".join(what.split()))
        super().__init__(f"{self.where}: {self.what}")

    def __reduce__(self) -> tuple[type[IdtoolError], tuple[str, str]]:
        return type(self), (self.where, self.what)  # so that processes can send errors to each other


def _one_line(text: str) -> str:
    """The text with unprintable characters escaped: names of files, keys and joints are untrusted."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class ConfigError(IdtoolError):
    """A configuration that cannot be used."""


class LogError(IdtoolError):
    """A log that cannot be read or contains too little data."""


class TransferError(LogError):
    """A file behind a URL that cannot be read; another try may succeed."""


class ModelError(IdtoolError):
    """A URDF that is invalid, or that is not consistent with the configuration."""


class SolverError(IdtoolError):
    """An optimization problem that is infeasible or was not solved to the required accuracy."""


class InfeasibleError(SolverError):
    """Constraints that no parameters satisfy."""
