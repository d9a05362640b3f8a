"""Every error that Sonobench raises for its user; each says what came, what was needed and what to do."""

from __future__ import annotations

from collections.abc import Sequence


class SonobenchError(Exception):
    """Base of every error that is the input's fault, not ours; the command line turns it into exit code 2."""


class InputError(SonobenchError):
    """A file, option or value that cannot be used as it stands."""


class TableError(SonobenchError):
    """One or more faults in a table (scene, study, component), all of them in one message.

    Attributes:
        faults: one sentence a fault, each beginning with the path of the faulty key.
    """

    def __init__(self, faults: Sequence[str]) -> None:
        self.faults = tuple(faults)
        super().__init__("\n".join(self.faults))

    def __reduce__(self) -> tuple[type[TableError], tuple[tuple[str, ...]]]:
        return type(self), (self.faults,)


class PluginError(SonobenchError):
    """A plugin that cannot be loaded, or a name that no plugin, or more than one, provides."""


class LogError(SonobenchError):
    """An MCAP file that cannot be read or written; the message begins with the file's path."""


class SetupError(SonobenchError):
    """A component that lacks what it needs from a recording (a sensor kind, a field, a `given`); names both sides."""


class UnavailableError(PluginError):
    """A component that is registered but cannot be loaded here (a missing import, an error in its module).

    Attributes:
        reason: why.
    """

    def __init__(self, role: str, name: str, reason: str) -> None:
        self.role, self.name, self.reason = role, name, reason
        super().__init__(f"{role} {name} is unavailable: {reason}")

    def __reduce__(self) -> tuple[type[UnavailableError], tuple[str, str, str]]:
        return type(self), (self.role, self.name, self.reason)
