"""Loops of a kernel's machine code, as Triton's nvdisasm lists it (SASS): which instructions run once in a program and
which once in each pass of which loop.

A loop is what graph theory calls a natural one: a branch back to a block that every way to the branch comes through.
Any other branch back, such as the return from a rarely used piece of code at the end, makes none. A call whose target
is a label of the function itself never returns: the assembler uses it as a branch, mostly out of a loop.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

_LINE = re.compile(r"^\s*/\*([0-9a-f]+)\*/\s+(?:(@!?U?P\w+)\s+)?([A-Z0-9_.]+)\s*([^;]*);")
_LABEL = re.compile(r"^(\.L_\w+):")
_TARGET = re.compile(r"`\((\.L_\w+)\)")
_ENDS = ("EXIT", "RET", "BRX", "KILL")


@dataclass(frozen=True)
class Instruction:
    """One instruction. predicate: whether it has one ("@P0"), "" without. name: with its modifiers, as in "LDG.E".
    operands: the rest of the line. target: the label that a branch leads to, or None."""

    predicate: str
    name: str
    operands: str
    target: str | None

    @property
    def kind(self) -> str:
        """The name without modifiers, as in "LDG"."""
        return self.name.partition(".")[0]


@dataclass(frozen=True)
class Part:
    """Instructions that run equally often: once in each pass of a loop, or once in the program.

    sometimes: for each instruction whether a branch may skip it, within the loop, or outside of loops within the
    program. depth: of loops around it, 0 for none. parent: the index of the part that this loop lies in, None for the
    program itself.
    """

    instructions: tuple[Instruction, ...]
    sometimes: tuple[bool, ...]
    depth: int
    parent: int | None


def parts(text: str) -> list[Part]:
    """The program's own part first, then a part for each loop in the order of the code, outer loops before the loops in
    them. What no way from the start leads to is left out, as are subroutines for divisions of rare numbers, and code
    for warps whose threads have gone apart (BRA.DIV), which these kernels' don't.

    Raises ValueError for a text without instructions.
    """
    blocks, edges = _blocks(text)
    before = _dominators(edges)
    loops: dict[int, set[int]] = {}
    tails: dict[int, set[int]] = {}
    for start, ends in edges.items():
        for end in ends:
            if start in before and end in before[start]:
                loops.setdefault(end, {end}).update(_body(edges, start, end))
                tails.setdefault(end, set()).add(start)
    inner = {block: _innermost(block, loops) for block in before}
    stops = [before[block] for block in before if not edges[block]]
    unavoidable = set.intersection(*stops) if stops else set(inner)
    found = [_part(blocks, [block for block in sorted(inner) if inner[block] is None], unavoidable, 0, None)]
    number: dict[int, int] = {}
    for head in sorted(loops, key=lambda head: (head, -len(loops[head]))):
        outer = _innermost(head, {h: body for h, body in loops.items() if loops[head] < body})
        parent = 0 if outer is None else number[outer]
        number[head] = len(found)
        always = set.intersection(*(before[tail] for tail in tails[head]))
        chosen = [block for block in sorted(inner) if inner[block] == head]
        found.append(_part(blocks, chosen, always, found[parent].depth + 1, parent))
    return found


def _part(blocks: list[list[Instruction]], chosen: list[int], always: set[int], depth: int, parent: int | None) -> Part:
    both = [(one, block not in always) for block in chosen for one in blocks[block]]
    return Part(tuple(one for one, _ in both), tuple(skipped for _, skipped in both), depth, parent)


def _innermost(block: int, loops: dict[int, set[int]]) -> int | None:
    around = [head for head, body in loops.items() if block in body]
    return min(around, key=lambda head: len(loops[head]), default=None)


def _read(text: str) -> Iterator[Instruction | str]:
    """Instructions and labels in order, up to the end of the first function."""
    for line in text.splitlines():
        if label := _LABEL.match(line):
            yield label[1]
        elif found := _LINE.match(line):
            target = _TARGET.search(found[4])
            yield Instruction(found[2] or "", found[3], found[4].strip(), target and target[1])


def _blocks(text: str) -> tuple[list[list[Instruction]], dict[int, list[int]]]:
    """Straight pieces of code, and from each one where it leads to."""
    blocks: list[list[Instruction]] = [[]]
    labels: dict[str, int] = {}
    for one in _read(text):
        if isinstance(one, str):
            if blocks[-1]:
                blocks.append([])
            labels[one] = len(blocks) - 1
            continue
        blocks[-1].append(one)
        if _jumps(one) or one.kind in _ENDS:
            blocks.append([])
    if not any(blocks):
        raise ValueError("no instructions in the listing")
    edges: dict[int, list[int]] = {}
    for number, block in enumerate(blocks):
        last = block[-1] if block else None
        leads = []
        if last is not None and _jumps(last) and last.target in labels and ".DIV" not in last.name:
            leads.append(labels[last.target])
        always = last is not None and (_jumps(last) or last.kind in _ENDS) and not _may_pass(last)
        if not always and number + 1 < len(blocks):
            leads.append(number + 1)
        edges[number] = leads
    return blocks, edges


def _jumps(one: Instruction) -> bool:
    """Whether it is a branch, not a call of a subroutine, whose name isn't a label of the function."""
    return one.kind == "BRA" or (one.kind == "CALL" and one.target is not None)


def _may_pass(branch: Instruction) -> bool:
    """Whether what follows a branch may run: it has a condition, before it or among its operands."""
    return bool(branch.predicate) or ".DIV" in branch.name or bool(re.match(r"!?U?P\d", branch.operands))


def _dominators(edges: dict[int, list[int]]) -> dict[int, set[int]]:
    """Of each block that can be reached, the blocks that every way to it comes through, with itself."""
    reached, left = {0}, [0]
    while left:
        for end in edges[left.pop()]:
            if end not in reached:
                reached.add(end)
                left.append(end)
    into: dict[int, list[int]] = {block: [] for block in reached}
    for start in reached:
        for end in edges[start]:
            into[end].append(start)
    found = {block: set(reached) for block in reached}
    found[0] = {0}
    changed = True
    while changed:
        changed = False
        for block in sorted(reached - {0}):
            new = set.intersection(*(found[start] for start in into[block])) | {block}
            if new != found[block]:
                found[block], changed = new, True
    return found


def _body(edges: dict[int, list[int]], tail: int, head: int) -> set[int]:
    """The blocks from which the branch back is reached without coming through the loop's head."""
    body, left = {head, tail}, [tail] if tail != head else []
    while left:
        block = left.pop()
        for start, ends in edges.items():
            if block in ends and start not in body:
                body.add(start)
                left.append(start)
    return body
