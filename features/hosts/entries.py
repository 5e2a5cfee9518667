"""Entries of networks on several hosts (`concord.entries`)."""

_HERE = "concord.features.hosts"

COMMANDS = {
    "up": (
        f"{_HERE}.commands:up",
        "Start a network on several hosts over ssh; show its log; end it.",
        "several hosts",
    ),
    "keys": (
        f"{_HERE}.keys_command:keys",
        "Make certificates and access control for a network, or check such files (--check).",
        "several hosts",
    ),
    "setup": (
        f"{_HERE}.commands:setup",
        "Work out a scenario and write it down, for the hosts of a network.",
        "several hosts",
    ),
    "router": (
        f"{_HERE}.commands:router",
        "Pass on the messages of a network's processes, on one of its hosts.",
        "several hosts",
    ),
    "environment": (
        f"{_HERE}.commands:environment",
        "Run the environment and recorder processes on this host until the run ends.",
        "several hosts",
    ),
    "node": (
        f"{_HERE}.commands:node",
        "Run some nodes of a network on this host until the run ends.",
        "several hosts",
    ),
}
