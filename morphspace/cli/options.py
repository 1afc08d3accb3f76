"""Build the command line of a verb from the declaration of its request."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from morphspace.requests import Verb, field_named, fields_of
from morphspace.settings import Field, WrongSetting

REPEATED = -1  # the `nargs` of click for any number of values


def parameters_of(request: type) -> list[click.Parameter]:
    """Return the click parameters of a request, arguments first.

    All of them accept text, which the request converts and checks.
    """
    fields = [field for field in fields_of(request) if field.spoken]
    arguments = [_argument(field) for field in fields if field.argument is not None]
    return [*arguments, *(_option(field) for field in fields if field.argument is None)]


class VerbCommand(click.Command):
    """A click command that refuses an option in place of another option's value, and one that is given twice."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the words. Raise a usage error that names the option whose values are missing or would be lost."""
        options = {
            flag: one for one in self.get_params(ctx) if isinstance(one, click.Option) for flag in one.opts
        }
        words, given = iter(args), set[str | None]()
        for flag in words:
            if flag == "--":
                break
            option = options.get(flag.partition("=")[0])
            if option is not None and not (option.multiple or option.is_flag):
                if option.name in given:
                    raise click.UsageError(
                        f"{flag.partition('=')[0]} is given twice; expected once, as only the last would count. Join "
                        "several values by commas",
                        ctx,
                    )
                given.add(option.name)
            if flag not in options or options[flag].is_flag:
                continue
            needed = options[flag].nargs
            for count in range(needed):
                word = next(words, None)
                if word is None or word in options:
                    where = "" if word is None else f" before {word}"
                    raise click.UsageError(
                        f"{flag} has {count} value{'s' if count != 1 else ''}{where}; expected {needed}. "
                        f"Give {options[flag].metavar}",
                        ctx,
                    )
        return super().parse_args(ctx, args)


def usage_of(verb: Verb) -> str:
    """Return the usage line of a verb: its arguments and required options."""
    fields = fields_of(verb.request)
    needed = [
        f"{field.flags[0]} {field.metavar}" for field in fields if field.required and not field.argument
    ]
    words = [field.spoken for field in fields if field.argument is not None]
    return " ".join(["morphspace", verb.name, *words, *needed])


def request_of_words(request: type, words: Mapping[str, Any]) -> Any:
    """Build a request from the words of the command line, by field name; fields without a word keep their defaults.

    Raises
    ------
    click.UsageError
        If a word does not fit its setting. The message names the option.
    """
    context = click.get_current_context()
    default = click.core.ParameterSource.DEFAULT
    given = {
        name: value for name, value in words.items() if context.get_parameter_source(name) is not default
    }
    try:
        return request(**given)
    except WrongSetting as error:
        raise click.UsageError(error.called(field_named(request, error.name).spoken), context) from error


def _argument(field: Field) -> click.Argument:
    return click.Argument(
        [field.name],
        nargs=field.word_count or REPEATED,
        required=field.required,
        type=click.UNPROCESSED,
        metavar=field.spoken,
    )


def _option(field: Field) -> click.Option:
    shared: dict[str, Any] = {"required": field.required, "help": _help(field)}
    if field.kind is bool:
        return click.Option([*field.flags, field.name], is_flag=True, **shared)
    if field.gives is not None:
        return click.Option([*field.flags, field.name], flag_value=field.gives, default=None, **shared)
    return click.Option(
        [*field.flags, field.name],
        type=click.UNPROCESSED,
        nargs=field.word_count or 1,
        multiple=field.word_count is None,
        metavar=field.metavar,
        **shared,
    )


def _help(field: Field) -> str:
    """Return the help of an option, with its default and its limits."""
    notes = [f"default: {field.default_words}"] if field.default_words else []
    if field.limits:
        notes.append(field.limits)
    return f"{field.help}  [{'; '.join(notes)}]" if notes else field.help
