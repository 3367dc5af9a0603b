"""`dofbench methods`: the methods that are found, and the presets and options of one of them."""

from __future__ import annotations

import itertools
import shutil
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

from dofbench.core.aligned import aligned
from dofbench.core.contracts import ListsOptions, MethodOption
from dofbench.core.errors import InputError
from dofbench.methods.cards import Card, Claims, MethodEntry, find_method, method_files
from dofbench.methods.frozen_presets import frozen_presets, preset_digest
from dofbench.runtime.ops import backend_of, backends, chosen

_WIDTH = 110  # characters per line, where the output isn't a terminal
_NARROWEST = 60
_HEADINGS = ("option", "default", "unit", "type")
_KERNEL_HEADINGS = ("kernel", "backend", "devices", "types", "bits repeat")


def print_methods(method: str | None = None) -> bool:
    """Print one line for each method, or all presets and options of one method.

    False when a method's card or class can't be read; a message is printed instead of it. Raises InputError for an
    unknown id, or when the card of the method that was asked for can't be read.
    """
    lines, whole = _every_method() if method is None else _one_method(find_method(method))
    print("\n".join(lines))
    return whole


def _every_method() -> tuple[list[str], bool]:
    rows, problems = [("method", "name", "devices", "presets", "claims from")], []
    for method in method_files():
        try:
            card = find_method(method).card
        except InputError as error:
            problems.append(f"no method: {error}")
            continue
        source = card.claims.source if card.claims is not None else "-"
        rows.append((method, card.name, ", ".join(card.devices), ", ".join(_preset_names(card)), source))
    ending = "Presets and options of a method: dofbench methods METHOD. * marks the default preset."
    return [*aligned(rows), *problems, "", ending], not problems


def _preset_names(card: Card) -> Iterator[str]:
    return (f"{name}*" if name == card.default_preset else name for name in card.presets)


def _one_method(entry: MethodEntry) -> tuple[list[str], bool]:
    card, able = entry.card, entry.card.capabilities
    lines = [f"{entry.id}: {card.name}", *_wrapped(card.summary, ""), *_wrapped(card.paper, ""), ""]
    lines += aligned(
        [
            ("folder", str(entry.folder)),
            ("devices", ", ".join(card.devices)),
            ("refocuses with a given lens", _yes(able.refocus)),
            ("learns the lens of every view", _yes(able.learns_lens)),
            ("needs sparse points", _yes(able.needs_points)),
        ]
    )
    lines += ["", "Presets (--preset NAME)", *_presets(entry)]
    lines += _skippable(card)
    lines += _kernels(card)
    options, whole = _options(entry)
    lines += ["", "Options (--set NAME=VALUE)", *options, "", "Figures published by the authors, on their own data"]
    lines += ["  nothing"] if card.claims is None else _claims(card.claims)
    return lines, whole


def _presets(entry: MethodEntry) -> Iterator[str]:
    """Every preset: when it is the default, its budget, and the options that it sets."""
    card, frozen = entry.card, frozen_presets(entry.folder)
    for name, declared in card.presets.items():
        _, _, budget = entry.preset(name)
        said = [
            *([_frozen_words(entry, name)] if name in frozen else []),
            *(["the default"] if name == card.default_preset else []),
            *(["the default on the built-in dataset"] if name == card.builtin_preset else []),
            *(["the default on a GPU"] if name == card.gpu_preset else []),
            *(f"without {part}" for part in entry.replaced_parts(declared)),
            *([f"budget {declared['budget']}"] if budget is not None and "budget" in declared else []),
            *([f"as {declared['extends']}, but"] if "extends" in declared else []),
        ]
        yield f"  {name}" + (f": {', '.join(said)}" if said else "")
        own = {key: value for key, value in declared.items() if key not in ("budget", "extends")}
        yield from _wrapped(_pairs(own), "      ")


def _frozen_words(entry: MethodEntry, preset: str) -> str:
    """Where the preset was fixed, and whether it is still the same."""
    frozen = frozen_presets(entry.folder)[preset]
    try:
        same = preset_digest(entry, preset) == frozen.digest
    except (ImportError, InputError):  # its class can't be loaded, which is said below the options
        same = True
    return f"fixed at {frozen.commit[:12]}" + ("" if same else ", and changed since")


def _skippable(card: Card) -> list[str]:
    """Lines with the options that the plan sets to skip a stage; none if the method has no such stage."""
    switches = {name: stage.switch for name, stage in card.stages_in_order() if stage.switch is not None}
    if not switches:
        return []
    lines = aligned([(f"  {stage}", _pairs(options)) for stage, options in switches.items()])
    return ["", "Options that the plan sets if a dataset doesn't need a stage (not with --force-all)", *lines]


def _kernels(card: Card) -> list[str]:
    """Which backends there are of the kernels that the method calls; no line where its card names no kernel.

    Its kernels repeat their bits on a device where each backend that a float32 call gets there says so of itself.
    """
    if not card.kernels:
        return []
    rows = [(f"  {_KERNEL_HEADINGS[0]}", *_KERNEL_HEADINGS[1:])]
    for op in card.kernels:
        for name in backends(op):
            backend = backend_of(op, name)
            repeat = _yes(backend.bits_repeat)
            rows.append((f"  {op}", name, ", ".join(backend.devices), ", ".join(backend.dtypes), repeat))
    lines = ["", "Kernels that it calls, and what each can run on", *aligned(rows)]
    for device in card.devices:
        changing = [op for op in card.kernels if not backend_of(op, chosen(op, device)).bits_repeat]
        said = f"all but {', '.join(changing)} give" if changing else "all give"
        lines.append(f"  On {device} {said} the same bits in every run, whatever the number of threads.")
    return lines


def _options(entry: MethodEntry) -> tuple[list[str], bool]:
    """Every option of the method's class, grouped by what it steers; False when the class can't be loaded."""
    try:
        kind = entry.method_class()
    except (ImportError, InputError) as error:
        return [f"  can't be listed: {' '.join(str(error).split())}"], False
    if not isinstance(kind, ListsOptions):
        return ["  unknown, since its class has no available_options; the presets above name some"], True
    every = kind.available_options()
    table = aligned([_HEADINGS, *((option.name, *_columns_of(option)) for option in every)])
    lines = [f"    {table[0]}", "    each with its meaning and source"]
    for group, options in itertools.groupby(zip(every, table[1:], strict=True), key=lambda pair: pair[0].group):
        lines += ["", f"  {group}"]
        for option, line in options:
            lines += [f"    {line}", *_wrapped(f"{option.meaning} Source: {option.source}.", "        ")]
    return lines, True


def _columns_of(option: MethodOption) -> tuple[str, str, str]:
    return _value(option.default), option.unit or "-", option.type


def _claims(claims: Claims) -> list[str]:
    """The published figures as a table, and their source."""
    metrics = list(dict.fromkeys(metric for row in claims.rows.values() for metric in row))
    rows = [("  measured on", *metrics)]
    rows += [
        (f"  {measured_on}", *(f"{row[metric]:g}" if metric in row else "-" for metric in metrics))
        for measured_on, row in claims.rows.items()
    ]
    return [*aligned(rows), *_wrapped(f"Source: {claims.source}", "  ")]


def _pairs(options: Mapping[str, Any]) -> str:
    return " ".join(f"{name}={_value(value)}" for name, value in options.items())


def _value(value: Any) -> str:
    """The value in the form that `--set` takes."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value) or '""'


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def _wrapped(text: str, indent: str) -> list[str]:
    width = max(_NARROWEST, shutil.get_terminal_size((_WIDTH, 0)).columns)
    return textwrap.wrap(
        text, width, initial_indent=indent, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
