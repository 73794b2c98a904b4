"""The command line: one thin function for each command. Heavy modules are imported where needed: help is fast."""

from __future__ import annotations

import copy
import os
import sys
from typing import TYPE_CHECKING

from idtool.cli import (  # noqa: F401  # each adds its command
    adapt,
    compare,
    diagnose,
    ellipsoids,
    excite,
    export,
    fit,
    init,
    inspect,
    reduce,
    sample,
    simulate,
    study,
    validate,
)
from idtool.cli.app import app
from idtool.common.exceptions import IdtoolError
from idtool.common.interrupt import EXIT_CODE, MESSAGE

if TYPE_CHECKING:
    import typer
    from typer.exceptions import TyperException

__all__ = ["app", "main"]


def main() -> None:
    """Run the command line; an error a user can act on is one line and exit code 2."""
    from typer.exceptions import Abort, TyperException

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small: threads would wait for each other
    try:
        arguments = sys.argv[1:] or ["--help"]
        code = _with_called_command(arguments[0])(arguments, prog_name="idtool", standalone_mode=False)
        sys.stdout.flush()
    except IdtoolError as error:
        code = _print_error(str(error))
    except TyperException as error:
        code = _print_error(_usage_message(error))
    except (Abort, KeyboardInterrupt):
        code = EXIT_CODE
    except (BrokenPipeError, SystemExit):  # who reads the output has had enough; rich makes the latter of it
        code = _discard_output()
    except OSError as error:
        if error.filename is not None:
            raise
        code = _discard_output() or _print_error(f"standard output: cannot be written to ({error.strerror})")
    if code == EXIT_CODE:  # typer may have made it of the interrupt
        sys.stderr.write(MESSAGE)
    sys.exit(code if isinstance(code, int) else 0)


def _with_called_command(name: str) -> typer.Typer:
    """The application with a command alone, since typer builds all that there are; all of them for another word."""
    called = [command for command in app.registered_commands if command.name == name]
    application = copy.copy(app)
    application.registered_commands = called or app.registered_commands
    return application


def _discard_output() -> int:
    """Give up standard output, so that the interpreter does not try it again at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _print_error(message: str) -> int:
    sys.stderr.write(f"error: {message}\n")
    return 2


def _plain_words(text: str) -> str:
    """The message of a parser without its own terms."""
    text = text.replace("Value error, ", "").replace("Input should", "should")
    return text.partition(", unable to parse")[0]


def _usage_message(error: TyperException) -> str:
    """A mistake in the command's words as one line."""
    if getattr(error, "option_name", None) == "--decide":
        return f"--decide: {excite.NEEDS_TWO}"
    similar = getattr(error, "possibilities", None)
    if similar:  # which typer puts after the message in its own words
        text = f"{error.message.rstrip('.')}; did you mean {' or '.join(sorted(similar))}?"
    else:
        text = _plain_words(" ".join(error.format_message().split()).rstrip("."))
    context = getattr(error, "ctx", None)
    command = context.command_path if context else "idtool"
    advice = f" Try {command} --help" if text.endswith("?") else f"; try {command} --help"
    return f"command: {text[:1].lower()}{text[1:]}{advice}"
