"""The command line, metrics, results and plots; imports scenarios and all below."""
