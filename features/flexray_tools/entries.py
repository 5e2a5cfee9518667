"""Entries of the tools for FlexRay buses (`concord.entries`)."""

_HERE = "concord.features.flexray_tools"

COMMANDS = {
    "flexray": (
        f"{_HERE}.commands.group:COMMANDS",
        "Recordings, clusters and plans of a FlexRay bus.",
        "bus",
    ),
}
CLUSTER_FILES = {
    ".xml": (f"{_HERE}.files.fibex:FIBEX", "FIBEX, versions 2 to 4."),
    ".arxml": (f"{_HERE}.files.arxml:ARXML", "AUTOSAR, classic platform, schema 4."),
}
NAMES = {
    "flexray": (f"{_HERE}.api", "Clusters, recordings, slot designs and response times."),
}
