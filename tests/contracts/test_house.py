"""How the code lies in its rooms."""

import ast
import re
import tomllib
from collections import Counter
from importlib.metadata import version
from pathlib import Path

import grimp
import pytest

from worker.delivery import overrides

ROOT = Path(__file__).parents[2]
HOUSES = ("simcore", "tomosim_contract", "worker", "api", "tomosim")
BESIDE = ("bench", "tests")
MAX_FILES = 20
MAX_LINES = 400


def circles(graph: grimp.ImportGraph) -> list[list[str]]:
    """Groups of modules of which each imports all others, by Tarjan's algorithm."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    groups = []

    def visit(module: str) -> None:
        order[module] = low[module] = len(order)
        stack.append(module)
        for other in graph.find_modules_directly_imported_by(module):
            if other not in order:
                visit(other)
            if other in stack:
                low[module] = min(low[module], low[other])
        if low[module] == order[module]:
            group = stack[stack.index(module) :]
            del stack[stack.index(module) :]
            if len(group) > 1:
                groups.append(sorted(group))

    for module in sorted(graph.modules):
        if module not in order:
            visit(module)
    return groups


def test_a_circle_is_seen():
    graph = grimp.ImportGraph()
    for importer, imported in [("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")]:
        graph.add_import(importer=importer, imported=imported)
    assert circles(graph) == [["a", "b", "c"]]


def test_no_module_imports_itself_by_way_of_others():
    graph = grimp.build_graph(*HOUSES, *BESIDE)
    assert {"bench.same", "bench.verification.plates", "tests.support.servers", "tests.golden.cases"} <= graph.modules
    assert circles(graph) == []


@pytest.mark.parametrize("house", HOUSES)
def test_nothing_that_is_installed_imports_tests_or_benches(house):
    graph = grimp.build_graph(*HOUSES, *BESIDE)
    for beside in BESIDE:
        assert not graph.find_shortest_chains(importer=house, imported=beside, as_packages=True)


@pytest.mark.parametrize("house", HOUSES + BESIDE)
def test_no_folder_is_crowded_and_no_file_long(house):
    files = sorted((ROOT / house).rglob("*.py"))
    crowded = {str(f.relative_to(ROOT)): n for f, n in Counter(f.parent for f in files).items() if n > MAX_FILES}
    long = {str(f.relative_to(ROOT)) for f in files if len(f.read_text().splitlines()) > MAX_LINES}
    assert (crowded, long) == ({}, set())


def test_what_is_replaced_in_pynetdicom_is_of_the_version_that_is_installed():
    assert version("pynetdicom") == overrides.VERSION
    assert f'"pynetdicom=={overrides.VERSION}"' in (ROOT / "pyproject.toml").read_text()


def test_the_picture_of_the_architecture_is_that_of_the_import_contracts():
    """docs/architecture.md shows every list of layers, top to bottom, as pyproject.toml has it."""
    page = (ROOT / "docs" / "architecture.md").read_text()
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    for contract in contracts:
        if contract["type"] == "layers":
            inside = contract.get("containers", [""])[0]
            rows = [layer.replace(f"{inside}." if inside else "\0", "") for layer in contract["layers"]]
            assert "\n".join(f"    {row}" for row in rows) in page


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "decisions").glob("*.md")), ids=lambda p: p.name)
def test_a_decision_has_a_context_a_decision_and_consequences(page):
    title, *parts = re.split(r"^## ", page.read_text(), flags=re.MULTILINE)
    assert re.fullmatch(rf"# {int(page.name[:4])}\. \S.*\n\n", title)
    assert [part.partition("\n")[0] for part in parts] == ["Context", "Decision", "Consequences"]
    assert all(part.partition("\n")[2].strip() for part in parts)


NO_NAMES = {"found", "made", "wanted", "told", "asked", "held", "given"}


def names_of(tree: ast.AST) -> set[str]:
    """What a module assigns to, and its parameters."""
    nodes = list(ast.walk(tree))
    variables = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    return variables | {node.arg for node in nodes if isinstance(node, ast.arg)}


def test_names_of_every_kind_are_seen():
    code = "def f(a, *b, c: int = 0): d: int = 1; e, (g := 2)\nfor h in []: pass\nwith x as i: pass\n[j for j in []]"
    assert names_of(ast.parse(code)) == set("abcdghij")


@pytest.mark.parametrize("house", [*HOUSES, "bench"])
def test_variables_are_called_by_nouns(house):
    files = list((ROOT / house).rglob("*.py"))
    names = {str(file.relative_to(ROOT)): sorted(NO_NAMES & names_of(ast.parse(file.read_text()))) for file in files}
    assert {file: words for file, words in names.items() if words} == {}
