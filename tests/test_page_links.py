"""Test that the targets of a page's links exist: files, pictures, other pages."""

import ast
import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.pages import ROOT, blocks

FOLDERS = sorted(link.name for link in (ROOT / "concord").iterdir() if link.is_symlink())
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_points_to_what_is_there(page: Path):
    targets = re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
    here = [target for target in targets if "://" not in target]
    assert [target for target in here if not (page.parent / target).exists()] == []


def test_pages_point_to_each_other():
    texts = [page.read_text(encoding="utf-8") for page in PAGES]
    assert sum(len(re.findall(r"\]\([^)]+\.(?:md|png)", text)) for text in texts) > 20


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_names_folders_and_files_of_the_source_that_are_there(page: Path):
    pattern = rf"`((?:{'|'.join(FOLDERS)})/[a-z_0-9/]*(?:\.\w+)?)`"
    named = re.findall(pattern, page.read_text(encoding="utf-8"))
    assert [name for name in named if not (ROOT / name).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_python_code_of_a_page_imports_what_is_there(page: Path):
    codes = blocks(page.read_text(encoding="utf-8"), "python")
    imports = [
        (node.module, name.name)
        for code in codes
        if "from concord" in code
        for node in ast.walk(ast.parse(code))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("concord")
        for name in node.names
    ]
    assert [pair for pair in imports if not _imports(*pair)] == []


def _imports(module: str | None, name: str) -> bool:
    assert module
    return hasattr(import_module(module), name) or find_spec(f"{module}.{name}") is not None
