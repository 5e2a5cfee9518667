"""Print findings of the prose rules, then counts by folder: `python -m tests.prose [PATH...]`.

Without a path, only the counts of the whole tree are printed. The exit code is 1 when there is a
finding.
"""

import sys
from collections import Counter
from pathlib import Path

from tests.prose.check import ROOT, files, findings


def main(arguments: list[str]) -> int:
    """Check files and folders; return the exit code."""
    paths = [Path(argument).resolve() for argument in arguments]
    found = [finding for file in files(paths or [ROOT]) for finding in findings(file)]
    if paths:
        sys.stdout.writelines(f"{finding}\n" for finding in found)
    counts = Counter(_folder(finding.path) for finding in found)
    for folder, count in sorted(counts.items()):
        sys.stdout.write(f"{count:6d}  {folder}\n")
    sys.stdout.write(f"{len(found):6d}  in all\n")
    return 1 if found else 0


def _folder(path: str) -> str:
    """Return the first two folders of a file, or the file itself at the root."""
    parts = Path(path).parts
    return "/".join(parts[: min(2, len(parts) - 1)]) or path


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
