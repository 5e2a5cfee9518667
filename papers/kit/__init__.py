"""The common kit of the papers: checks, claims, figures, traces and the report."""
