"""Claims and errata of the papers, from the reports of `concord reproduce` into docs/papers/.

`make paper-tables` runs the reproductions and writes the tables. Each page keeps its own text;
the tables stand between two marks at its end.
"""

import sys
from pathlib import Path

import msgspec

from concord.papers.kit.report import REPORT_JSON, ReproductionReport, Section, claim_tables

PAGES = Path(__file__).resolve().parent / "papers"
BEGIN, END = "<!-- begin: tables of the report -->", "<!-- end: tables of the report -->"


def tables(report: ReproductionReport) -> str:
    """The tables of claims and errata of a report, one after the other."""
    claims = [claim for section in report.sections for claim in section.claims]
    errata = [erratum for section in report.sections for erratum in section.errata]
    of_claims = claim_tables(Section(0, "", claims=claims))
    of_errata = claim_tables(Section(0, "", errata=errata))
    return "\n\n".join([
        BEGIN,
        f"`concord reproduce {report.paper}` made these tables with seed {report.seed} and "
        f"{report.runs} runs.",
        f"## Claims: {len(claims)}",
        *of_claims,
        f"## Errata: {len(errata)}",
        *of_errata,
        END,
    ])  # fmt: skip


def write(report: ReproductionReport) -> Path:
    """Put the tables of a report into its page; the page exists."""
    page = PAGES / f"{report.paper}.md"
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2].strip("\n")
    text = f"{before.rstrip()}\n\n{tables(report)}\n"
    page.write_text(text + (f"\n{after}\n" if after else ""), encoding="utf-8")
    return page


if __name__ == "__main__":
    for folder in sys.argv[1:]:
        content = (Path(folder) / REPORT_JSON).read_bytes()
        print(write(msgspec.json.decode(content, type=ReproductionReport)))
