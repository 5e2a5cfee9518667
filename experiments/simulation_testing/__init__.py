"""Random scenarios under random faults, checked against an independent ledger."""
