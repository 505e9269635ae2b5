"""The sign flips: every term of a sum, and every value that is a single term, negated one at a time.

    a - b   ->  a + b        a + b  ->  a - b        x -= a  ->  x += a        x += a  ->  x -= a
    -a      ->  a            a (first of a sum, or the whole of an assigned, returned or listed value)  ->  -a

The first two rows and the deletion of a minus are cosmic-ray's own operators. The last one is ours: without it the
sign of a term that happens to stand first (``cos * u - sin * v``), or alone (``J[0, 2] = cos``), is never tried.
Source  https://cosmic-ray.readthedocs.io/en/latest/reference/operators.html
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, TypeAlias

from cosmic_ray.ast import ast_nodes, get_ast  # type: ignore[import-untyped]
from cosmic_ray.mutating import mutate_code  # type: ignore[import-untyped]
from cosmic_ray.operators import binary_operator_replacement, unary_operator_replacement  # type: ignore[import-untyped]
from cosmic_ray.operators.operator import Example, Operator  # type: ignore[import-untyped]

TERMS = {"name", "number", "atom_expr", "term", "power", "atom"}
"""What a minus may stand before: all but sums, signed factors, comparisons, conditions and strings."""

NO_SIGN = ("-", "0", "[", "np.empty", "np.zeros", "range")
"""How values begin whose negative is tried elsewhere, is the same, or is no number."""

Node: TypeAlias = Any
"""parso's, whose types are half there."""

Span: TypeAlias = tuple[tuple[int, int], tuple[int, int]]


class AugmentedSign(Operator):  # type: ignore[misc]
    """Operator that exchanges ``+=`` and ``-=``."""

    FLIPPED = {"+=": "-=", "-=": "+="}  # noqa: RUF012

    def mutation_positions(self, node: Node) -> Iterator[Span]:
        """Yield the position of the operator."""
        if getattr(node, "value", None) in self.FLIPPED:
            yield node.start_pos, node.end_pos

    def mutate(self, node: Node, index: int) -> Node:  # noqa: ARG002
        """Return the node with the other operator."""
        node.value = self.FLIPPED[node.value]
        return node

    @classmethod
    def examples(cls) -> Iterable[Example]:
        """Return examples for the documentation."""
        return (Example("x += 1", "x -= 1"),)


class LeadingSign(Operator):  # type: ignore[misc]
    """Operator that puts a minus before a term without a sign."""

    def mutation_positions(self, node: Node) -> Iterator[Span]:
        """Yield the position of the term."""
        if node.type in TERMS and _begins_a_sum(node) and not _without_sign(node) and not _in_subscript(node):
            yield node.start_pos, node.end_pos

    def mutate(self, node: Node, index: int) -> Node:  # noqa: ARG002
        """Return the negated term: a minus binds weaker than a power and negates a product as a whole."""
        leaf = node.get_first_leaf()
        leaf.value = "-" + leaf.value
        return node

    @classmethod
    def examples(cls) -> Iterable[Example]:
        """Return examples for the documentation."""
        return (Example("x = a * b", "x = -a * b"), Example("x = a - b", "x = -a - b"))


def _begins_a_sum(node: Node) -> bool:
    parent, before = node.parent, node.get_previous_sibling()
    match parent.type:
        case "arith_expr":
            return before is None
        case "expr_stmt":  # into a place of an array; a value given a name has a sign where the name is used
            return bool(
                parent.children[0].type == "atom_expr" and before is not None and before.get_code().strip() == "="
            )
        case "testlist_star_expr":  # many at once: into places, or returned
            first = parent.parent.children[0]
            return first is not parent and (first.type == "keyword" or "[" in first.get_code())
        case "testlist_comp":  # of a list, not of a tuple: those are shapes and slices
            return bool(parent.get_first_leaf().get_previous_leaf().value == "[")
        case "argument":
            return bool(node.type == "atom_expr" and parent.children[0].type == "name")
        case "return_stmt":
            return node.type in {"name", "term"}
    return False


def _without_sign(node: Node) -> bool:
    """Return True for a value that has no sign to flip: it has a minus, is zero, is not filled yet, or is a count."""
    return bool(node.get_code(include_prefix=False).startswith(NO_SIGN))


def _in_subscript(node: Node) -> bool:
    above = node.parent
    while above is not None and not (above.type == "trailer" and above.children[0].value == "["):
        above = above.parent
    return above is not None


OPERATORS = (
    *(x() for x in binary_operator_replacement.operators() if x.__name__.endswith(("_Add_Sub", "_Sub_Add"))),
    *(x() for x in unary_operator_replacement.operators() if x.__name__.endswith("_Delete_USub")),
    AugmentedSign(),
    LeadingSign(),
)


def mutants(source: str) -> list[tuple[int, str]]:
    """Yield each mutant with the number of the line that it changes, in the order of the lines."""
    found = []
    for operator in OPERATORS:
        lines = [at[0][0] for node in ast_nodes(get_ast(source)) for at in operator.mutation_positions(node)]
        found += [(line, mutate_code(source, operator, n)) for n, line in enumerate(lines)]
    return sorted(found)
