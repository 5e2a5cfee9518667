"""docs/gallery.md: its commands draw its pictures."""

from pathlib import Path

import pytest
from PIL import Image

from docs import gallery

pytestmark = pytest.mark.slow


@pytest.mark.study
@pytest.mark.slow
def test_the_commands_of_the_page_draw_its_pictures(tmp_path: Path):
    gallery.draw(tmp_path)
    drawn = {str(file.relative_to(tmp_path)) for file in tmp_path.rglob("*.png")}
    assert drawn == set(gallery.pictures()) and len(drawn) >= 6
    for name in drawn:
        with Image.open(tmp_path / name) as new, Image.open(gallery.DOCS / name) as kept:
            assert new.size == kept.size and len(new.getcolors(256) or ()) > 20, name


def test_the_pages_pictures_are_small():
    """A reader of the README and of the site loads them all."""
    for file in (*gallery.DOCS.rglob("*.png"), *gallery.DOCS.rglob("*.gif")):
        assert file.stat().st_size < 1_500_000, file
