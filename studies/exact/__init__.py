"""Networks of linear plants without a random number: moments of all errors (`cc.exact`)."""
