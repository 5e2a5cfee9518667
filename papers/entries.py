"""Entries of the reproductions of papers (`concord.entries`)."""

COMMANDS = {
    "reproduce": (
        "concord.papers.reproduce:reproduce",
        "Reproduce a paper; exit code 1 if a check fails.",
        "study",
    ),
}
