"""Entries of the tools for FlexRay buses (`concord.entries`)."""

_HERE = "concord.features.flexray_tools"

COMMANDS = {
    "flexray": (
        f"{_HERE}.commands.group:COMMANDS",
        "Recordings, clusters and plans of a FlexRay bus.",
    ),
}
NAMES = {
    "flexray": (f"{_HERE}.api", "Clusters, recordings, slot designs and response times."),
}
