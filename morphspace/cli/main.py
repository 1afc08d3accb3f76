"""The command line: it converts words to requests, shows progress, prints outcomes, and sets the exit code.

The exit code is 0 for success, 2 for input that the user can correct, 1 for a fault of ours, 130 for an interruption.
Heavy modules are imported only when a verb runs, so help is fast.
"""

from __future__ import annotations

import difflib
import io
import json
import os
import re
import signal
import sys
import threading
from typing import TYPE_CHECKING, Annotated, Any

import click

from morphspace import __version__
from morphspace.cli.options import VerbCommand, parameters_of, request_of_words
from morphspace.errors import INTERRUPTED, BadInput, MorphspaceError
from morphspace.requests import GROUPS, Verb, Workers, declared, verb_named, verb_names
from morphspace.settings import Help, Option

if TYPE_CHECKING:
    from morphspace.outcome import Outcome
    from morphspace.steps import Step, Steps

PROGRESS_AFTER_S = 2.0  # seconds; shorter work draws no bar
# Seconds; on a terminal, and in a log file, where each update adds a line
PROGRESS_EVERY_S, IN_A_LOG_EVERY_S = 0.1, 30.0
CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]+")  # names in messages may hold what moves a terminal's cursor


@declared
class SharedRequest:
    """The options that every verb takes."""

    workers: Workers = None
    quiet: Annotated[bool, Help("Print nothing but errors.")] = False
    as_json: Annotated[bool, Option("--json"), Help("Print the outcome as JSON, for machines.")] = False
    debug: Annotated[bool, Help("Show a traceback when something fails.")] = False


class Verbs(click.Group):
    """A click group of the verbs; it imports a verb when called, and prints usage errors in one line."""

    def __init__(self, *args: Any, prefix: str = "", **extra: Any) -> None:
        super().__init__(*args, **extra)
        self.prefix = prefix

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the verbs and groups of this group."""
        names = [name.removeprefix(self.prefix) for name in verb_names() if name.startswith(self.prefix)]
        return sorted({name.partition(" ")[0] for name in names})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Build the command of a verb from the declaration of its request."""
        if cmd_name not in self.list_commands(ctx):
            return None
        if not self.prefix and cmd_name in GROUPS:
            return Verbs(cmd_name, prefix=f"{cmd_name} ", help=GROUPS[cmd_name])
        return _command(cmd_name, verb_named(self.prefix + cmd_name))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command of a name. Raise a usage error with the nearest name if there is none."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            near = difflib.get_close_matches(args[0], self.list_commands(ctx), 1)
            if not near:
                raise
            raise click.UsageError(f"{error.message} Did you mean {near[0]}?", error.ctx) from error

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the verbs with the first sentence of their help, without building their options."""
        names = self.list_commands(ctx)
        helps = {name: GROUPS.get(name) or verb_named(self.prefix + name).help for name in names}
        limit = formatter.width - 6 - max(map(len, names))
        with formatter.section("Commands"):
            formatter.write_dl(
                [
                    (name, click.Command(name, help=text).get_short_help_str(limit))
                    for name, text in helps.items()
                ]
            )

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run the command and exit; a usage error is printed in one line."""
        extra["standalone_mode"] = False
        if isinstance(sys.stdout, io.TextIOWrapper):  # a legacy code page lacks most characters
            sys.stdout.reconfigure(errors="replace")
        given = args[0] if args else extra.get("args")
        is_told = "--json" in (sys.argv[1:] if given is None else given)  # the option is not parsed yet
        try:
            code = super().main(*args, **extra)
        except click.UsageError as error:
            if (
                type(error).__name__ == "NoArgsIsHelpError"
            ):  # `morphspace` alone: its message is the help itself
                click.echo(error.format_message())
                sys.exit(2)
            words = error.ctx.command_path if error.ctx else "morphspace"
            _fail(f"{_sentence(error.format_message())} See {words} --help", 2, "Usage" if is_told else None)
        except click.Abort:
            _fail("stopped", INTERRUPTED, "Interrupted" if is_told else None)
        except OSError as error:  # of the standard output: a verb's own files raise `UnwritableFile`
            os.dup2(
                os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno()
            )  # what is buffered is lost in silence
            why = error.strerror or str(error)
            _fail(f"cannot write to the standard output: {why}. Free space, or send it elsewhere", 2, None)
        sys.exit(code if isinstance(code, int) else 0)


@click.group(
    cls=Verbs,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="morphspace")
def main() -> None:
    """Controllable face models for psychophysics, from clips or photographs.

    Start with `morphspace demo`, or with your own frames: `morphspace build-model clips/*.png`.
    """


def _tidy_up_when_asked_to_stop() -> None:
    """End a verb on SIGTERM and SIGHUP as on Ctrl-C, so that no unfinished file stays; nohup is respected."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):
            if signal.getsignal(number) == signal.SIG_DFL:
                signal.signal(number, signal.default_int_handler)


def _command(name: str, verb: Verb) -> click.Command:
    """Build the command of a verb: its own parameters, and those of all verbs."""
    shared = parameters_of(SharedRequest)
    names = {parameter.name for parameter in shared}

    def callback(**words: Any) -> int:
        given = request_of_words(SharedRequest, {key: words[key] for key in names})
        return _run(verb, {key: word for key, word in words.items() if key not in names}, given)

    params = [*parameters_of(verb.request), *shared]
    return VerbCommand(name, params=params, callback=callback, help=verb.help)


def _run(verb: Verb, words: dict[str, Any], shared: SharedRequest) -> int:
    """Run the verb with the given words, print its outcome, and return the exit code."""
    _tidy_up_when_asked_to_stop()
    try:
        request = request_of_words(verb.request, words)
        from morphspace.steps import using_workers

        with using_workers(shared.workers):
            outcome = _driven(verb.run(request), shared.quiet or shared.as_json)
    except KeyboardInterrupt:
        if shared.debug:
            raise
        _fail(
            "stopped; all written files are complete. Run the same command to resume",
            INTERRUPTED,
            "Interrupted" if shared.as_json else None,
        )
    except MorphspaceError as error:
        if shared.debug:
            raise
        _fail(
            str(error),
            2 if isinstance(error, BadInput) else 1,
            type(error).__name__ if shared.as_json else None,
        )
    except click.UsageError:
        raise
    except Exception as error:
        if shared.debug:
            raise
        _fail(
            f"a fault of morphspace ({type(error).__name__}: {error}); run again with --debug and report it",
            1,
            "Fault" if shared.as_json else None,
        )
    _show(outcome, shared.quiet, shared.as_json)
    return outcome.exit_code


def _driven(steps: Steps[Outcome], silent: bool) -> Outcome:
    """Run the steps with one progress bar per stage; a bar appears only after two seconds of work."""
    from morphspace.steps import result_of

    if silent:
        return result_of(steps)
    from tqdm import tqdm

    stage, bar = "", None

    def on_step(step: Step) -> None:
        nonlocal stage, bar
        for line in step.lines:
            click.echo(CONTROL.sub(" ", line), err=True)
        if bar is None or step.stage != stage or step.done < bar.n:
            if bar is not None:
                bar.close()
            stage = step.stage
            bar = tqdm(
                desc=stage,
                total=step.total,
                delay=PROGRESS_AFTER_S,
                mininterval=PROGRESS_EVERY_S if sys.stderr.isatty() else IN_A_LOG_EVERY_S,
                leave=False,
                file=sys.stderr,
                unit=" ",
            )
        bar.update(step.done - bar.n)

    try:
        return result_of(steps, on_step)
    finally:
        if bar is not None:
            bar.close()


def _show(outcome: Outcome, quiet: bool, as_json: bool) -> None:
    for warning in outcome.warnings:
        if not quiet:
            click.echo(f"note: {_one_line(warning)}", err=True)
    if as_json:
        document = {**outcome.document, "warnings": list(outcome.warnings)}
        click.echo(json.dumps(document, indent=2, sort_keys=True))
    elif not quiet:
        for line in outcome.lines:
            click.echo(CONTROL.sub(" ", line))


def _sentence(words: str) -> str:
    return words if words.endswith(("?", "?)")) else f"{words.rstrip('.')}."


def _one_line(text: str) -> str:
    return " ".join(CONTROL.sub(" ", text).split())


def _fail(message: str, code: int, kind: str | None = None) -> None:
    """Print one line on the error stream, and the same as JSON on standard output if `kind` is given; then exit."""
    line = _one_line(message)
    click.echo(f"morphspace: {line}", err=True)
    if kind is not None:
        error = {"exit_code": code, "kind": kind, "message": line}
        click.echo(json.dumps({"error": error}, indent=2, sort_keys=True))
    sys.exit(code)
