"""Section of `concord reproduce labelled`: what is exact, held against independent searches."""

from concord.papers.kit.checks import at_most
from concord.papers.kit.report import Section, markdown_table
from concord.papers.labelled.exact import FULL_INFORMATION, audit, full_information

NETWORKS = 50
TOLERANCE = 1e-9


def exact_section(networks: int) -> Section:
    """Exactness with full information; records in use, and each once, in random networks."""
    full = [(options, full_information(options)) for options in FULL_INFORMATION]
    audits = [audit(number) for number in range(networks)]
    checks = [
        at_most(
            f"all records in time, {_words(options)}: deviation from centralised", far, TOLERANCE
        )
        for options, far in full
    ]
    pairs = sum(one.pairs for one in audits)
    checks += [
        at_most(f"{networks} random networks: records missing", sum(a.missing for a in audits), 0),
        at_most(
            f"{networks} random networks: records in use that could not be there",
            sum(a.impossible for a in audits),
            0,
        ),
        at_most(
            f"{networks} random networks: deviation from the filter that is given what each node "
            "uses, each record once",
            max(a.deviation for a in audits),
            TOLERANCE,
        ),
    ]
    rows = [
        (a.what, str(a.pairs), str(a.missing), str(a.impossible), f"{a.deviation:.1e}")
        for a in audits
    ]
    text = (
        "Deviations are relative: of means to the largest value of each state, of covariances to "
        "standard deviations.\n\nIn every random network, after every step, the records that each "
        "node uses are held against a search of the schedule that knows nothing of the rule: "
        f"{pairs} (node, step, record) in all. Then, with a window that never passes, every "
        "node's last estimate is held against a filter that is given exactly the records in use, "
        "each once.\n\n"
        + markdown_table(("network", "could be in use", "missing", "impossible", "dev."), rows)
    )
    return Section(1, "Exactness", text, checks=checks)


def _words(options: dict) -> str:
    relay = ", relay" if options.get("relay") else ""
    return f"{options['scenario']}, {options['graph']}, {options['rounds']} rounds{relay}"
