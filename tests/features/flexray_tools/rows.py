"""Rows of the tables of the core's tests, as `tests/features/rows.py` says."""

REFUSED = {
    "flexray design-turns --scenario target-tracking": [
        ("--nodes 4 --graph complete --rule labelled --shares 4 --cluster audi", "not linear"),
    ],
    "flexray design-turns --scenario oscillator --nodes 4 --graph complete --rule labelled": [
        ("--shares 1", "--cluster fitted: turns are static slots"),
        ("--shares 99 --cluster audi", "use at most --shares"),
        ("--shares 1 --longest 3 --cluster audi", "use 1, 2, 4"),
        ("--shares 1 --longest 2 --cluster audi", "allow more slots or longer turns"),
    ],
    "flexray clocks audi": [
        ("--nodes 1", "--nodes is 1, but must be from 2 to 2047"),
        ("--cycles 0", "--cycles is 0, but must be from 1"),
        ("--power-on-cycles nan", "--power-on-cycles is nan"),
        ("--drift 1,2", "--drift has 2 numbers, but there are 20 nodes"),
        ("--drift fast", "--drift is 'fast', but must be one number"),
        ("--drift nan", "clocks deviate by -10000 to 10000 millionths"),
        ("--liars 15", "audi' has 15 sync nodes; choose from 0 to 14"),
        ("--out clocks.txt", "a picture ends in .png, .svg, .pdf"),
        ("--out nowhere/clocks.png", "no such folder nowhere"),
        ("--seed -1", "--seed is -1, but must be 0 or more"),
    ],
    "flexray plan": [
        (
            "--scenario oscillator --occupancy 0.5 --trigger 1 --schedule full",
            "belongs to --schedule",
        ),
        ("--nodes -1", "--nodes -1: must be at least 1"),
        ("--bus ideal", "without time"),
        ("--cluster /nowhere/c.toml", "No such file"),
        ("--schedule full --occupancy 0.5", "belongs to --schedule round-robin"),
    ],
    "flexray show": [
        ("--bus ideal", "without time"),
        ("--cluster /nowhere/c.toml", "No such file"),
        ("--schedule full --occupancy 0.5", "belongs to --schedule round-robin"),
    ],
}
