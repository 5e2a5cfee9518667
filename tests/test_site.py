"""The documentation site: it builds without a warning, and loads nothing from other addresses."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
# A browser fetches these by itself. A link that a reader clicks may lead anywhere.
_LOADED = re.compile(
    r"<(?:script|img|iframe|source)[^>]*\ssrc=\"([^\"]+)\"|<link[^>]*href=\"([^\"]+)\""
)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "sphinx", "-b", "html", "-q", "-W", "docs", str(folder)]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_the_site_has_every_page_and_loads_nothing_from_elsewhere(site: Path):
    docs = ROOT / "docs"
    pages = {str(page.relative_to(docs).with_suffix("")) for page in docs.rglob("*.md")}
    built = {
        str(page.relative_to(site).with_suffix("")): page.read_text(encoding="utf-8")
        for page in site.rglob("*.html")
    }
    assert pages <= set(built)
    for name, text in built.items():
        loaded = [one or other for one, other in _LOADED.findall(text)]
        assert not [address for address in loaded if re.match(r"(https?:)?//", address)], name
    for script in site.glob("_static/**/*.css"):
        assert not re.search(r"url\(['\"]?https?:", script.read_text(encoding="utf-8")), script


@pytest.mark.slow
def test_the_reference_has_every_public_name(site: Path):
    from concord.entries import entries

    text = (site / "reference.html").read_text(encoding="utf-8")
    modules = {"buses", "filters", "flexray", "holds", "rules", "schedules", "topology"}
    missing = [name for name in entries("NAMES") if name not in modules and f">{name}<" not in text]
    assert missing == []
