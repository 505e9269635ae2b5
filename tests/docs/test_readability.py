"""Readability: the figures of ``readability.py`` stay below their limits, and each check finds what it looks for."""

from __future__ import annotations

import ast

import pytest

from tests.docs import readability
from tests.docs.readability import OF_CODE, OF_TESTS, Place, Source

# Highest number of places allowed. A limit is lowered when the code has become better; it is never raised.
LIMITS = {
    "docstrings that open with a fragment": 0,
    "unidiomatic words": 0,
    "public names of ltv_mpc without a docstring": 0,
    "public functions of ltv_mpc without a Parameters section": 20,  # overrides, which say nothing again
    "functions above 60 lines": 0,
    "functions with more than 8 parameters": 0,
    "classes with more than 12 attributes": 0,
    "folders of services that import each other": 0,
    "private attributes in tests": 20,
    "patched names in tests": 40,
    "names of tests above 80 characters": 0,
}

# Places that may stay as they are and are not counted: figure, then file and name, then the reason.
EXCEPTIONS: dict[str, dict[str, str]] = {
    "functions above 60 lines": {
        "services/cli/bus.py _block": "the block of bus options, each with its help text",
    },
    "functions with more than 8 parameters": {
        "services/cli/start.py sim": "a typer command declares each of its options as a parameter",
        "services/cli/ros2.py ros2": "a typer command declares each of its options as a parameter",
        "services/cli/dive.py plan_": "a typer command declares each of its options as a parameter",
        "services/cli/vehicle.py controller": "a typer command declares each of its options as a parameter",
        "ltv_mpc/vehicle/dynamics.py rates": "innermost kernel of every cycle; the reason is at the function",
        "ltv_mpc/vehicle/flow.py advance_by": "innermost kernel; the head of its file says why",
        "ltv_mpc/vehicle/sensitivity.py linearise_stage": "innermost kernel; the head of its file says why",
    },
}


def _key(place: Place) -> str:
    return f"{place.path} {place.text.partition(':')[0]}"


@pytest.fixture(scope="module")
def figures() -> dict[str, list[Place]]:
    return readability.figures()


@pytest.mark.parametrize("figure", LIMITS)
def test_no_figure_is_above_its_limit(figure: str, figures: dict[str, list[Place]]) -> None:
    counted = [place for place in figures[figure] if _key(place) not in EXCEPTIONS.get(figure, {})]
    listed = "\n".join(map(str, counted))
    assert len(counted) <= LIMITS[figure], f"{len(counted)} {figure}, at most {LIMITS[figure]}:\n{listed}"


def test_every_figure_has_a_limit() -> None:
    assert LIMITS.keys() == OF_CODE.keys() | OF_TESTS.keys()


def test_every_exception_is_still_needed(figures: dict[str, list[Place]]) -> None:
    for figure, places in EXCEPTIONS.items():
        assert places.keys() <= {_key(place) for place in figures[figure]}


# --- the checks themselves -------------------------------------------------------------------------------------------


def _source(text: str, path: str = "ltv_mpc/sample.py") -> list[Source]:
    return [Source(path, text, ast.parse(text))]


@pytest.mark.parametrize(
    ("summary", "is_fragment"),
    [
        ("Return the thrust (N).", False),
        ("F = M a", False),
        ("x' = f(x, F, c), the horizontal motion.", False),
        ("Of one filter.", True),
        ("Whether it fits.", True),
        ("The state at the end.", True),
        ("state at the end.", True),
        ("Offset of the clock.", False),
    ],
)
def test_a_fragment_is_a_summary_that_is_no_statement(summary: str, is_fragment: bool) -> None:
    text = f'def f():\n    """{summary}"""\n'
    assert bool(readability.fragments(_source(text))) == is_fragment


def test_a_property_or_a_class_may_open_with_an_article() -> None:
    text = 'class C:\n    """The vehicle."""\n    @property\n    def mass(self):\n        """The mass (kg)."""\n'
    assert not readability.fragments(_source(text))


@pytest.mark.parametrize(
    ("check", "bad", "good"),
    [
        (readability.unidiomatic_words, "x = 1  # as was said", "x = 'as was said'"),
        (readability.unidiomatic_words, '"""Begun anew."""', '"""Started again, made up of parts."""'),
        (readability.missing_docstrings, "def f(): ...", "def _f(): ..."),
        (
            readability.undescribed_parameters,
            'def f(a, b):\n    """Add."""',
            'def f(a, b):\n    """Add.\n\n    Parameters\n    ----------\n    a, b : terms.\n    """',
        ),
        (readability.long_functions, "def f():\n" + 60 * "    x = 1\n", "def f():\n" + 59 * "    x = 1\n"),
        (
            readability.many_parameters,
            "def f(a, b, c, d, e, *, g, h, i, j): ...",
            "def f(a, b, c, d, e, *, g, h, i): ...",
        ),
        (
            readability.many_attributes,
            "class C:\n    def f(self):\n" + "".join(f"        self.a{i} = 0\n" for i in range(13)),
            "class C:\n    def f(self):\n" + "".join(f"        self.a{i} = 0\n" for i in range(12)),
        ),
        (readability.private_attributes, f"node.{'_state'}", "self._state"),
        (readability.private_attributes, f"node.{'_replaced'}", "pair._replace(x=1)"),
        (readability.patched_names, f"{'monkeypatch'}.setattr(m, 'f', g)", "monkeypatch.setenv('A', 'b')"),
        (readability.long_test_names, f"def test_{76 * 'x'}(): ...", f"def test_{75 * 'x'}(): ..."),
    ],
)
def test_each_check_finds_its_fault_and_nothing_else(check, bad, good) -> None:  # type: ignore[no-untyped-def]
    assert check(_source(bad))
    assert not check(_source(good))


def test_folders_that_import_each_other_are_found() -> None:
    one = _source("from services.bus.wire import decode\n", "services/run/summary.py")
    other = _source("from services.run.summary import of_recording\n", "services/bus/wire.py")
    assert len(readability.mutual_imports(one + other)) == 2
    assert not readability.mutual_imports(one)
