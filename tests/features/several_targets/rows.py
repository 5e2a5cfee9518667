"""Rows of the tables of the core's tests, as `tests/features/rows.py` says."""

REFUSED = {
    "run --scenario target-swarm": [
        ("--detection 1", "--detection 1.0: must be in (0.001, 1); choose for example 0.9"),
        ("--detection 0", "--detection 0.0: must be in (0.001, 1); choose for example 0.9"),
        ("--clutter -1", "--clutter -1.0: must be in [0, 200]; choose for example 5"),
        ("--clutter 201", "--clutter 201.0: must be in [0, 200]; choose for example 5"),
        ("--targets 100000", "--targets 100000: must be 1 to 200"),
        ("--targets 0", "--targets 0: must be 1 to 200"),
        ("--merge-m -1", "--merge-m -1.0: must be 0 or more"),
        ("--association nearst", "nearst"),
        ("--payload-bytes 16 --loss 0.1", "raise --payload-bytes"),
        ("--rule hcmci", "--rule hcmci: must be labelled"),
        ("--rule track-ci --filter imm", "a share carries one belief a track"),
        ("--filter ekf", "--filter ekf: must be ukf or imm"),
        ("--withhold-below 0.1", "--withhold-below 0.1: must be 0: a record is a scan"),
        ("--record-number float32", "--record-number float32: must be int16"),
        ("--changes '5 set rounds=2'", "target-swarm has one rule and schedule of its own"),
        ("--changes '5 set graph=ring'", "target-swarm has one rule and schedule of its own"),
        ("--changes '5 set placement=1@0/0'", "target-swarm has one rule and schedule of its own"),
        ("--nodes 2 --placement -1", "placement -1: must be 0 or more"),
    ],
}
SMALL_NETWORKS = {"target-swarm": {"targets": 3, "clutter": 2, "steps": 10, "rounds": 2}}
PAGES = {"targets": ""}
