"""Claims and errata of the papers in docs/papers/, from code.

`python -m docs.paper_tables` writes the errata, whose printed and correct texts are data of
`papers/*/claims.py`. With folders of `concord reproduce` it also writes the claims of their
reports. `make paper-tables` does both. The tables stand between marks at the end of each page.
"""

import json
import sys
from pathlib import Path
from typing import Any

from concord.papers.adlukf import claims as adlukf
from concord.papers.kit.judging import Erratum, errata_from
from concord.papers.kit.report import REPORT_JSON, Section, claim_tables, markdown_table
from concord.papers.liu2021 import claims as liu2021
from concord.papers.meng2025 import claims as meng2025
from concord.papers.wac import claims as wac

PAGES = Path(__file__).resolve().parent / "papers"
ERRATA: dict[str, list[Erratum]] = {
    "meng2025": errata_from(meng2025.PRINTED),
    "liu2021": errata_from(liu2021.PRINTED),
    "adlukf": adlukf.ERRATA,
    "wac": wac.ERRATA,
}


def errata_of(paper: str) -> str:
    """The errata of a paper, without the figures that its report adds."""
    errata = ERRATA[paper]
    (table,) = claim_tables(Section(0, "", errata=errata))
    return f"## Errata: {len(errata)}\n\n{table}"


def claims_of(report: dict[str, Any]) -> str:
    """The claims of a paper with what a report (`report.json`) measured."""
    claims = [claim for section in report["sections"] for claim in section["claims"]]
    rows = [(one["where"], one["says"], one["verdict"], one["measured"]) for one in claims]
    table = markdown_table(("where", "the paper says", "verdict", "measured"), rows)
    return (
        f"## Claims: {len(claims)}\n\n`concord reproduce {report['paper']}` measured this with "
        f"seed {report['seed']} and {report['runs']} runs.\n\n{table}"
    )


def between(kind: str) -> tuple[str, str]:
    """The marks around the tables of a kind."""
    return f"<!-- begin: {kind} from code -->", f"<!-- end: {kind} from code -->"


def written(page: str, kind: str, tables: str) -> str:
    """The text of a page with these tables of a kind."""
    begin, end = between(kind)
    before, _, rest = page.partition(begin)
    after = rest.partition(end)[2].strip("\n")
    text = f"{before.rstrip()}\n\n{begin}\n\n{tables}\n\n{end}\n"
    return text + (f"\n{after}\n" if after else "")


def _write(paper: str, kind: str, tables: str) -> None:
    page = PAGES / f"{paper}.md"
    page.write_text(written(page.read_text(encoding="utf-8"), kind, tables), encoding="utf-8")


if __name__ == "__main__":
    for name in ERRATA:
        _write(name, "errata", errata_of(name))
    for folder in sys.argv[1:]:
        made = json.loads((Path(folder) / REPORT_JSON).read_text(encoding="utf-8"))
        _write(made["paper"], "claims", claims_of(made))
