"""The sign flips: every term of a sum, and every value that is a single term, negated one at a time.

    a - b   ->  a + b        a + b  ->  a - b        x -= a  ->  x += a        x += a  ->  x -= a
    -a      ->  a            a (first of a sum, or the whole of an assigned, returned or listed value)  ->  -a

The first two rows and the deletion of a minus are cosmic-ray's own operators. The last one is ours: without it the
sign of a term that happens to stand first (``cos * u - sin * v``), or alone (``J[0, 2] = cos``), is never tried.
Source  https://cosmic-ray.readthedocs.io/en/latest/reference/operators.html
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators import binary_operator_replacement, unary_operator_replacement
from cosmic_ray.operators.operator import Example, Operator
from parso.tree import NodeOrLeaf

TERMS = {"name", "number", "atom_expr", "term", "power", "atom"}
"""What a minus may stand before: all but sums, signed factors, comparisons, conditions and strings."""

Span = tuple[tuple[int, int], tuple[int, int]]


class AugmentedSign(Operator):  # type: ignore[misc]
    """``+=`` for ``-=`` and the reverse."""

    FLIPPED = {"+=": "-=", "-=": "+="}  # noqa: RUF012

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[Span]:
        """The operator itself."""
        if getattr(node, "value", None) in self.FLIPPED:
            yield node.start_pos, node.end_pos

    def mutate(self, node: NodeOrLeaf, index: int) -> NodeOrLeaf:  # noqa: ARG002
        """The other one."""
        node.value = self.FLIPPED[node.value]  # type: ignore[attr-defined]
        return node

    @classmethod
    def examples(cls) -> Iterable[Example]:
        """For whoever reads."""
        return (Example("x += 1", "x -= 1"),)


class LeadingSign(Operator):  # type: ignore[misc]
    """A minus before a term that has no sign of its own."""

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[Span]:
        """The term."""
        if node.type in TERMS and _stands_alone_or_first(node) and not _in_subscript(node):
            yield node.start_pos, node.end_pos

    def mutate(self, node: NodeOrLeaf, index: int) -> NodeOrLeaf:  # noqa: ARG002
        """Its negative: a minus binds less than a power and turns a product round as a whole."""
        leaf = node.get_first_leaf()
        leaf.value = "-" + leaf.value
        return node

    @classmethod
    def examples(cls) -> Iterable[Example]:
        """For whoever reads."""
        return (Example("x = a * b", "x = -a * b"), Example("x = a - b", "x = -a - b"))


def _stands_alone_or_first(node: NodeOrLeaf) -> bool:
    parent, before = node.parent, node.get_previous_sibling()
    if parent is None or (node.type == "atom" and node.get_first_leaf().value != "("):
        return False
    if parent.type == "arith_expr":
        return before is None
    if parent.type in {"expr_stmt", "annassign", "argument"}:
        return getattr(before, "value", None) == "="
    if parent.type == "testlist_star_expr":  # a tuple: of values, not of targets
        return parent.get_next_sibling() is None or parent.get_next_sibling().type != "operator"
    return parent.type in {"return_stmt", "testlist", "testlist_comp"}


def _in_subscript(node: NodeOrLeaf) -> bool:
    above = node.parent
    while above is not None and not (above.type == "trailer" and above.get_first_leaf().value == "["):
        above = above.parent
    return above is not None


OPERATORS = (
    *(x() for x in binary_operator_replacement.operators() if x.__name__.endswith(("_Add_Sub", "_Sub_Add"))),
    *(x() for x in unary_operator_replacement.operators() if x.__name__.endswith("_Delete_USub")),
    AugmentedSign(),
    LeadingSign(),
)


def mutants(source: str) -> list[tuple[int, str]]:
    """Each with the number of the line that it changes, by line."""
    found = []
    for operator in OPERATORS:
        lines = [at[0][0] for node in ast_nodes(get_ast(source)) for at in operator.mutation_positions(node)]
        found += [(line, mutate_code(source, operator, n)) for n, line in enumerate(lines)]
    return sorted(found)
