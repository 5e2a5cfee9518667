"""Features: each folder brings its own scenarios, rules, filters, buses, figures and commands."""
