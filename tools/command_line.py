"""From words of the command line to a command with its arguments: tyro's parser, errors on one line.

Knows functions, their signatures and presets; knows nothing of what a command does.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any

from mapping.errors import ConfigError
from mapping.settings import override
from reconstruction.config import preset
from tools.options import nested_setting

Command = Callable[..., Any]
FRAMES = re.compile(r"[\u2500-\u257f]+|-{5,}")
"""Lines and corners of the boxes that tyro draws around its errors."""
SECTIONS = ("Missing from", "Perhaps you meant", "Unrecognized options", "Available subcommands")
"""How the parts of an error begin that list arguments."""
HELP_INDENT = 8
"""Columns from the frame on at which tyro explains an argument that it has named."""
WRONG_COUNT = re.compile(
    r"^Error parsing (\S+?):? .*input length (\d+) did not match expected argument count (\d+)"
)


def with_preset(command: Command, arguments: Sequence[str]) -> Command:
    """The same command, the defaults of its `settings` being those of the preset that the words name."""
    if "settings" not in inspect.signature(command).parameters:
        return command
    name = "tabletop"
    for word, following in zip(arguments, [*arguments[1:], ""]):
        if word == "--preset":
            name = following
        elif word.startswith("--preset="):
            name = word.partition("=")[2]
    chosen = preset(name)

    @functools.wraps(command)
    def preset_command(*args: Any, **kwargs: Any) -> Any:
        return command(*args, **kwargs)

    signature = inspect.signature(command)
    parameters = [
        p.replace(default=chosen) if p.name == "settings" else p for p in signature.parameters.values()
    ]
    preset_command.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return preset_command


def parse(
    commands: Mapping[str, Command], prog: str, description: str | None, arguments: Sequence[str]
) -> Callable[[], Any]:
    """The call that a command line asks for. Help leaves by SystemExit(0); bad words raise ConfigError."""
    import tyro

    calls: list[Callable[[], Any]] = []

    def remembered(command: Command) -> Command:
        @functools.wraps(command)
        def remember(*args: Any, **kwargs: Any) -> None:
            calls.append(functools.partial(command, *args, **kwargs))

        return remember

    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            tyro.extras.subcommand_cli_from_dict(
                {name: remembered(command) for name, command in commands.items()},
                prog=prog,
                description=description,
                args=list(arguments),
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.AvoidSubcommands),
            )
    except SystemExit as stop:
        if stop.code in (0, None):
            raise
        command = commands.get(arguments[0]) if arguments else None
        if command:
            _check_settings(command, arguments)
        helpful = f"{prog} {arguments[0]} --help" if command else f"{prog} --help"
        sentence = _one_line(said.getvalue())
        raise ConfigError(f"{sentence}{_one_value_each(sentence, arguments)}; see {helpful}") from None
    return calls[0]


def _check_settings(command: Command, arguments: Sequence[str]) -> None:
    """Raise ConfigError that says what is valid when an option such as --mesh.spacin 3 is no setting."""
    settings = inspect.signature(command).parameters.get("settings")
    if settings is None:
        return
    sections = [field.name for field in fields(settings.default)]
    for word, following in zip(arguments, [*arguments[1:], ""]):
        name, given, value = word.partition("=")
        if name.startswith("--") and ("." in name or name[2:] in sections):
            dotted = name[2:].replace("-", "_")
            override(settings.default, nested_setting(f"{dotted}={value if given else following}"))


def _one_line(box: str) -> str:
    """A box of several lines as one sentence: without its title, which its first line says again, the help
    texts of arguments, and the footer."""
    said: list[str] = []
    listing = False
    for line in box.splitlines()[1:]:
        inner = FRAMES.sub(" ", line).strip("|+\n")
        text = " ".join(inner.strip("• ").split())
        if text.startswith(("For full helptext", "Argument helptext")):
            break
        if text.startswith(SECTIONS):
            listing = True
            said[-1:] = [f"{last};" for last in said[-1:]]
        # Below the name of an argument stands its help, further in.
        if text and not (listing and len(inner) - len(inner.lstrip()) >= HELP_INDENT):
            said.append(text)
    sentence = " ".join(said) or " ".join(box.split())
    sentence = sentence.replace("options: ", "words: ", 1) if _no_option(sentence) else sentence
    counted = WRONG_COUNT.search(sentence)
    if counted is None:
        return sentence
    name, given, wanted = counted.groups()
    return f"{name} takes {wanted} values, {given} given"


def _no_option(sentence: str) -> bool:
    return sentence.startswith("Unrecognized options: ") and " -" not in sentence


def _one_value_each(said: str, arguments: Sequence[str]) -> str:
    """The advice for words that no option takes, such as the second file after --labels; empty for others."""
    if not said.startswith("Unrecognized words: "):
        return ""
    first = said.removeprefix("Unrecognized words: ").split(", ")[0]
    before = arguments[: arguments.index(first)] if first in arguments else []
    option = next((word for word in reversed(before) if word.startswith("-")), None)
    return f" ({option} takes one value)" if option and before[-1] != option else ""
