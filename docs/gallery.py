"""Draw the pictures of docs/gallery.md by the commands of that page: `make pictures`."""

import re
import shlex
import subprocess
import tempfile
from pathlib import Path

from PIL import Image

from concord.runtime.interpreter import fresh_command, fresh_variables

DOCS = Path(__file__).parent
PAGE = DOCS / "gallery.md"
COLOURS = 128


def commands() -> list[str]:
    """Return the commands of the page, without those of other scripts."""
    blocks = re.findall(r"^```sh\n(.*?)^```$", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]


def pictures() -> list[str]:
    """Return the pictures of those commands, as the page names them."""
    return re.findall(r"\]\((gallery/[^)]+)\)", PAGE.read_text("utf-8"))


def draw(out: Path) -> None:
    """Run the commands, and write their pictures below a folder, with few colours.

    Raises:
        CalledProcessError: a command fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        for command in commands():
            program, *words = shlex.split(command)
            assert program == "concord", f"{command}: the page has other commands indented"
            subprocess.run(
                fresh_command("concord.experiments", *words),
                env=fresh_variables(),
                cwd=folder,
                check=True,
            )
        for name in pictures():
            target = out / name
            target.parent.mkdir(parents=True, exist_ok=True)
            with Image.open(Path(folder) / "runs" / name) as picture:
                reduced = picture.convert("RGB").quantize(COLOURS, Image.Quantize.MAXCOVERAGE)
                reduced.save(target, optimize=True)


if __name__ == "__main__":
    draw(DOCS)
