"""Commands and public functions of the core (`concord.entries`)."""

_CLI = "concord.experiments.cli"
_API = "concord.experiments.python_api"
_STUDIES = "concord.experiments.python_studies"

COMMANDS = {
    "run": (
        f"{_CLI}.run:run",
        "Run a network, and print how well each of its nodes did.",
        "start",
    ),
    "new": (
        f"{_CLI}.new:new",
        "Write a folder with a plant, a rule, tests, a sweep and a figure of your own.",
        "start",
    ),
    "list": (
        f"{_CLI}.list:list_all",
        "List scenarios, rules, filters, faults, and names that options of network and bus take.",
        "start",
    ),
    "check": (
        f"{_CLI}.check:check",
        "Check the promises of a rule, a filter, an arbiter or a scenario in drawn cases;"
        " the exit code is 1 if one is broken.",
        "start",
    ),
    "agree": (
        f"{_CLI}.agree:agree",
        "Run a scenario in every driver; exit code 1 if they do not agree.",
        "start",
    ),
    "collect": (
        f"{_CLI}.collect:collect",
        "Finish the recording of a run that was interrupted; make its arrays, capture and figures.",
        "start",
    ),
    "audit": (
        f"{_CLI}.audit:audit_folder",
        "Account for each estimate, share, step, join and death of a run, from its "
        "recording; the exit code is 1 if a promise is broken.",
        "start",
    ),
    "doctor": (
        f"{_CLI}.doctor:doctor",
        "Look whether this machine can run a network; exit code 1 if something is failing.",
        "start",
    ),
    "help": (
        f"{_CLI}.command_line:show_help",
        "Explain concord or one of its commands.",
        "start",
    ),
    "version": (
        f"{_CLI}.command_line:print_version",
        "Print the version of concord, as `concord --version` does.",
        "start",
    ),
    "completion": (
        f"{_CLI}.command_line:print_completion",
        "Print the script with which a shell completes commands and options.",
        "start",
    ),
    "sweep": (
        f"{_CLI}.sweep:sweep",
        "Run all combinations of values; print error and cost.",
        "study",
    ),
    "design": (
        f"{_CLI}.design:design",
        "Find the cheapest network that meets an error target. Fields given are settled, "
        "or are looked for among the given values; graph, rule, weights, rounds, "
        "occupancy, schedule, formats of numbers and relay are open. The network must "
        "bear all placements given: runs take one after the other.",
        "study",
    ),
    "compare": (
        f"{_CLI}.compare:compare",
        "Compare all fusion rules, and your own, on a fixed suite of cases with fixed noise.",
        "study",
    ),
    "identify": (
        f"{_CLI}.identify:identify_values",
        "Find the noise, delays and parameters that explain the readings of a scenario best.",
        "study",
    ),
    "plot": (
        f"{_CLI}.plot:plot",
        "Draw a result.",
        "study",
    ),
    "report": (
        f"{_CLI}.report:report",
        "Write a result as one self-contained page.",
        "study",
    ),
    "merge": (
        f"{_CLI}.sweep:merge",
        "Make the result of a sweep from the folders of its shards.",
        "study",
    ),
    "topology": (
        f"{_CLI}.topology:COMMANDS",
        "Graphs: show, analyse, compare, generate.",
        "study",
    ),
    "replay": (
        f"{_CLI}.dashboard:replay",
        "Show a recorded run in the browser: its run.mcap or its folder; or the result of a sweep.",
        "page",
    ),
    "dashboard": (
        f"{_CLI}.dashboard:dashboard",
        "Watch and control a network that runs, in the browser.",
        "page",
    ),
    "control": (
        f"{_CLI}.control:control",
        "Pause, kill, cut or change a network that runs; exit code 2 if it refuses.",
        "page",
    ),
}
NAMES = {
    "figures": (
        f"{_API}:figures",
        "The figures of runs: those of `concord run --json`, under the same names.",
    ),
    "agree": (
        f"{_API}:agree",
        "Where the drivers differ on a scenario; empty if they agree (contract 5 of "
        "ARCHITECTURE.md).",
    ),
    "compare": (
        f"{_STUDIES}:compare",
        "Every built-in rule and your own on a fixed suite of cases; docs/which_rule_when.md.",
    ),
    "design": (
        f"{_STUDIES}:design",
        "The cheapest network that meets an error target; its `recommended` is None if none does.",
    ),
    "exact": (
        f"{_STUDIES}:exact",
        "The errors of a network on a linear plant, exact to rounding, without runs; "
        "docs/exact.md.",
    ),
    "launch": (
        f"{_API}:launch",
        "Run a scenario with one process per node; the data set is that of `load`.",
    ),
    "load": (
        f"{_API}:load",
        "The data set of a run folder, or of a file that `sweep` has written; "
        "docs/results.md and docs/sweeps.md name every variable. A variable is read from "
        "the file when it is first used.",
    ),
    "identify": (
        f"{_STUDIES}:identify",
        "The noise, delays and parameters that explain the readings of a scenario best; "
        "docs/own_data.md.",
    ),
    "plots": (
        f"{_STUDIES}:plots",
        "Return the pictures of a sweep or a design by name.",
    ),
    "scenario": (
        f"{_API}:scenario",
        "The scenario of a name, or of a file (FILE.py:NAME), with options as in `concord run`.",
    ),
    "simulate": (
        f"{_API}:simulate",
        "Runs of a scenario, all at once where its rule has an array form.",
    ),
    "sweep": (
        f"{_STUDIES}:sweep",
        "Every combination of the options' values; docs/sweeps.md names the variables.",
    ),
}
