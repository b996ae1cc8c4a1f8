"""Command lines: errors in one line with the nearest name, shell completion."""

from __future__ import annotations

import argparse
import difflib
import shlex
import sys
from enum import IntEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

__all__ = ["CommandParser", "ExitCode", "GroupedHelp", "did_you_mean", "hint_at_name"]


class ExitCode(IntEnum):
    """Exit codes of all commands; those above 64 are of sysexits.h. docs/reference/cli.md."""

    OK = 0
    FAULT = 1
    USAGE = 2
    NOT_ALL = 3
    BAD_DATA = 65
    NO_INPUT = 66
    UNAVAILABLE = 69
    CANNOT_WRITE = 73
    TRY_AGAIN = 75
    PROTOCOL = 76
    NO_PERMISSION = 77
    BAD_CONFIG = 78
    INTERRUPTED = 130


SHELLS = ("bash", "zsh", "tcsh")
MAX_SHOWN = 3
"""Commands that are named as having an option."""

UNKNOWN = "unrecognized arguments: "


def hint_at_name(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """Return `did you mean NAME?` for the nearest known name.

    Args:
        name: was given and is not known.
        known: all names.
        otherwise: is returned if none is near.
    """
    near = difflib.get_close_matches(name, [one for one in known if one != name], n=1)
    return f"did you mean {near[0]}?" if near else otherwise


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return `; did you mean NAME?` for the nearest known name, or nothing."""
    hint = hint_at_name(name, known)
    return f"; {hint}" if hint else ""


class CommandParser(argparse.ArgumentParser):
    """Reports an error in one line, with the nearest command or option.

    Attributes:
        groups: names of commands by title, for help; empty lists all commands in their order.
    """

    groups: Mapping[str, tuple[str, ...]] = MappingProxyType({})

    def error(self, message: str) -> NoReturn:
        """Exit with code 2."""
        if message.startswith(UNKNOWN):
            word = message.removeprefix(UNKNOWN).split()[0].partition("=")[0]
            message += self._hint(word)
        self.exit(ExitCode.USAGE, f"{self.prog}: {message} (see {self.prog} --help)\n")

    def add_completion(self, whole: Callable[[], argparse.ArgumentParser] | None = None) -> None:
        """Add `--print-completion SHELL`.

        Args:
            whole: makes the parser to complete, where it is not this one.
        """
        self.add_argument(
            "--print-completion",
            action=_PrintCompletion,
            const=whole,
            dest=argparse.SUPPRESS,
            default=argparse.SUPPRESS,
            choices=SHELLS,
            help="print a completion script for a shell",
        )

    def add_version(self, version: str) -> None:
        """Add `--version` here and to all subcommands, but where the option means something else.

        Args:
            version: text that the option prints.
        """
        if "--version" not in self._option_string_actions:
            self.add_argument("--version", action="version", version=version)
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 no public name
                for command in action.choices.values():
                    command.add_version(version)

    def _check_value(self, action: argparse.Action, value: object) -> None:
        choices = action.choices
        is_command = isinstance(action, argparse._SubParsersAction)  # noqa: SLF001 no public name
        if choices is None or value in choices or not is_command:
            super()._check_value(action, value)
            return
        hint = did_you_mean(str(value), choices) or f"; allowed: {', '.join(choices)}"
        raise argparse.ArgumentError(None, f"there is no command {value!r}{hint}")

    def _get_formatter(self) -> argparse.HelpFormatter:
        formatter = super()._get_formatter()
        if isinstance(formatter, GroupedHelp):
            formatter.groups = self.groups
        return formatter

    def _hint(self, word: str) -> str:
        """Return where an option belongs, else the nearest option, else nothing."""
        commands = self._options()
        if word in commands[""]:
            return f"; it belongs before the command: {self.prog} {word} ..."
        having = [f"{self.prog} {name}" for name, options in commands.items() if word in options]
        if having:
            shown = having if len(having) <= MAX_SHOWN else [*having[:MAX_SHOWN], "other commands"]
            return f"; it is an option of {', '.join(shown)}"
        return did_you_mean(word, set().union(*commands.values()))

    def _options(self) -> dict[str, set[str]]:
        """Return the options of the command, as "", and of its subcommands, by their names."""
        options = {"": set(self._option_string_actions)}
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 as above
                for name, command in action.choices.items():
                    options[name] = set(command._option_string_actions)  # noqa: SLF001 as above
        return options


class GroupedHelp(argparse.RawDescriptionHelpFormatter):
    """Lists commands by group."""

    groups: Mapping[str, tuple[str, ...]] = MappingProxyType({})

    def _format_action(self, action: argparse.Action) -> str:
        if not self.groups or not isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 as above
            return super()._format_action(action)
        commands = {command.dest: command for command in action._get_subactions()}  # noqa: SLF001 as above
        blocks = []
        for title, names in self.groups.items():
            lines = [super(GroupedHelp, self)._format_action(commands[name]) for name in names]
            blocks.append(f"\n {title}:\n{''.join(lines)}")
        return "".join(blocks)


class _PrintCompletion(argparse.Action):
    """Print the script and exit."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,  # noqa: ARG002 the base class's signature
        values: Any,  # noqa: ANN401 the base class's signature
        option_string: str | None = None,  # noqa: ARG002 as above
    ) -> None:
        try:
            import shtab  # noqa: PLC0415 of an extra
        except ImportError:
            python = shlex.quote(sys.executable or "python3")
            text = f"shtab cannot be imported; to install it: {python} -m pip install shtab"
            parser.exit(ExitCode.BAD_CONFIG, f"{parser.prog}: {text}\n")
        whole = self.const() if self.const is not None else parser
        sys.stdout.write(f"{shtab.complete(whole, shell=values)}\n")
        parser.exit(0)
