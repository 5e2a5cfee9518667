"""The papers that concord reproduces; only the `reproduce` command imports this package."""
