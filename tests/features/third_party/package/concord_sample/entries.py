"""Entries of the sample (`concord.entries`)."""

RULES = {
    "widest": (
        "concord_sample.rule:widest",
        "Mean of the means, with the widest covariance.",
        "concord_sample.options:Widest",
    ),
}
SCENARIOS = {
    "short-oscillator": (
        "concord_sample.scenario:DEFINITION",
        "The oscillator for a few steps.",
        "concord_sample.options:ShortOscillator",
    ),
}
COMMANDS = {
    "greet": ("concord_sample.command:greet", "Greet a user by name."),
}
