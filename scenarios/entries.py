"""Scenarios, rules, filters, buses and schedules of the core, by name (`concord.entries`)."""

_DEFINITIONS = "concord.scenarios.definitions"
_TYPES = "concord.scenarios.types"

SCENARIOS = {
    "target-tracking": (
        f"{_DEFINITIONS}.target_tracking:TURNING",
        "A turning target seen by range-bearing sensors with a limited field of view.",
        f"{_TYPES}.plants:TargetTracking",
    ),
    "target-crossing": (
        f"{_DEFINITIONS}.target_tracking:CROSSING",
        "A target on a straight course seen by the same sensors.",
        f"{_TYPES}.plants:TargetCrossing",
    ),
    "oscillator": (
        f"{_DEFINITIONS}.oscillator:DEFINITION",
        "Lightly damped oscillator; nodes see position, velocity or nothing.",
        f"{_TYPES}.plants:DampedOscillator",
    ),
}
RULES = {
    "ci": (
        "concord.scenarios.rule_table.rules_of_beliefs:CI",
        "Covariance intersection: consistent for any correlation, never less tight than wac.",
        f"{_TYPES}.rules:CovarianceIntersection",
    ),
    "sharp-ci": (
        "concord.scenarios.rule_table.rules_of_beliefs:SHARP_CI",
        "ci with weights that go to the sharper beliefs of a neighbourhood: less error and "
        "caution.",
        f"{_TYPES}.rules:SharpCovarianceIntersection",
    ),
    "trimmed-ci": (
        "concord.scenarios.rule_table.rules_of_beliefs:TRIMMED_CI",
        "ci that --liars of a node's neighbours cannot drag away; needs twice as many neighbours.",
        f"{_TYPES}.rules:TrimmedCovarianceIntersection",
    ),
    "wac": (
        "concord.scenarios.rule_table.rules_of_beliefs:WAC",
        "Weighted average of means and covariances (the paper's): no inverse, may diverge.",
        f"{_TYPES}.rules:WeightedAverage",
    ),
    "hcmci": (
        "concord.scenarios.rule_table.rules_of_rounds:HCMCI",
        "Consensus on prior and novelty, safe gain: consistent, near centralised with more rounds.",
        f"{_TYPES}.rules:HybridConsensus",
    ),
    "icf": (
        "concord.scenarios.rule_table.rules_of_rounds:ICF",
        "Information-weighted consensus in the bytes of ci: overconfident before rounds converge.",
        f"{_TYPES}.rules:InformationConsensus",
    ),
    "diffusion": (
        "concord.scenarios.rule_table.rules_of_rounds:DIFFUSION",
        "Readings of the neighbours, then averaged means; covariance not fused: not consistent.",
        f"{_TYPES}.rules:DiffusionRule",
    ),
    "kcf": (
        "concord.scenarios.rule_table.rules_of_rounds:KCF",
        "Readings of the neighbours, then a pull to their means: not consistent, takes no weights.",
        f"{_TYPES}.rules:KalmanConsensus",
    ),
    "labelled": (
        "concord.scenarios.rule_table.labelled_rule:LABELLED",
        "Measurements with labels, each counted once: near centralised in a fraction of the bytes.",
        f"{_TYPES}.rules:MeasurementFlooding",
    ),
    "local": (
        "concord.scenarios.rule_table.rules_of_beliefs:LOCAL",
        "Every node alone: publishes, but fuses nothing.",
        f"{_TYPES}.rules:LocalRule",
    ),
    "centralised": (
        "concord.scenarios.rule_table.rules_of_rounds:CENTRALISED",
        "All readings at every node: the optimum; complete graph, full schedule, one round.",
        f"{_TYPES}.rules:CentralisedRule",
    ),
}
FILTERS = {
    "ukf": (
        "concord.scenarios.filter_table.filter_entry:UKF",
        "Unscented Kalman filter, with the sigma points of the scenario.",
        f"{_TYPES}.filters:UnscentedFilter",
    ),
    "ckf": (
        "concord.scenarios.filter_table.filter_entry:CKF",
        "Cubature Kalman filter: sigma points of equal positive weights.",
        f"{_TYPES}.filters:CubatureFilter",
    ),
    "srukf": (
        "concord.scenarios.filter_table.filter_entry:SRUKF",
        "Unscented Kalman filter in square-root form: no difference of covariances.",
        f"{_TYPES}.filters:SquareRootUnscented",
    ),
    "srckf": (
        "concord.scenarios.filter_table.filter_entry:SRCKF",
        "Cubature Kalman filter in square-root form: no difference of covariances.",
        f"{_TYPES}.filters:SquareRootCubature",
    ),
    "ekf": (
        "concord.scenarios.filter_table.filter_entry:EKF",
        "Extended Kalman filter, with Jacobians by central differences.",
        f"{_TYPES}.filters:TangentFilter",
    ),
    "kf": (
        "concord.scenarios.filter_table.filter_entry:KF",
        "Kalman filter, for plants and sensors that are linear; takes a singular covariance.",
        f"{_TYPES}.filters:LinearFilter",
    ),
    "iplf": (
        "concord.scenarios.filter_table.filter_entry:IPLF",
        "Iterated posterior linearisation: the ukf, linearised where the reading leads.",
        f"{_TYPES}.filters:PosteriorLinearisation",
    ),
    "iekf": (
        "concord.scenarios.filter_table.filter_entry:IEKF",
        "Iterated extended Kalman filter: the ekf, linearised where the reading leads.",
        f"{_TYPES}.filters:IteratedTangentFilter",
    ),
    "imm": (
        "concord.scenarios.filter_table.filter_entry:IMM",
        "Interacting multiple models: the ukf of a straight course and that of a turn.",
        f"{_TYPES}.filters:InteractingMultipleModels",
    ),
}
BUSES = {
    "flexray": (
        "concord.scenarios.bus_table.flexray_plan:FLEXRAY",
        "FlexRay: static and dynamic slots of a cluster, with times.",
        f"{_TYPES}.buses:FlexRay",
    ),
    "ideal": (
        "concord.scenarios.bus_table.bus_definition:IDEAL",
        "Slots without time: whatever the schedule allows is transmitted.",
        f"{_TYPES}.buses:Ideal",
    ),
}
SCHEDULES = {
    "full": ("", "Every node publishes in every cycle.", f"{_TYPES}.schedules:FullSchedule"),
    "round-robin": (
        "",
        "Nodes publish in turns of fixed order.",
        f"{_TYPES}.schedules:RoundRobinSchedule",
    ),
    "hybrid": (
        "",
        "Half of the slots are static and the nodes without one contend for the others.",
        f"{_TYPES}.schedules:HybridSchedule",
    ),
    "hybrid-leaves": (
        "",
        "hybrid in which the nodes with the fewest neighbours own the static slots.",
        f"{_TYPES}.schedules:LeavesSchedule",
    ),
    "dynamic": (
        "",
        "All nodes contend for all slots.",
        f"{_TYPES}.schedules:DynamicSchedule",
    ),
}
NAMES = {
    "OwnPlant": ("concord.plants.own_plant:OwnPlant", "A plant of your own."),
    "OwnSensor": ("concord.plants.own_sensor:OwnSensor", "A sensor of your own."),
    "Truth": (
        "concord.plants.own_truth:TruePlant",
        "A plant and its sensors as they really are.",
    ),
    "TrueSensor": ("concord.plants.own_sensor:TrueSensor", "A sensor as it really is."),
    "from_control": (
        "concord.plants.linear_systems:from_control",
        "A plant from a model of python-control or scipy.",
    ),
    "own_scenario": (
        f"{_DEFINITIONS}.own:own_scenario",
        "A scenario of your own plant and sensors.",
    ),
    "Scenario": ("concord.scenarios.scenario:Scenario", "The simulated case."),
    "buses": (f"{_TYPES}.buses", "Buses as values."),
    "schedules": (f"{_TYPES}.schedules", "Schedules as values."),
    "holds": (f"{_TYPES}.holds", "Hold policies as values."),
    "rules": (f"{_TYPES}.rules", "Fusion rules as values."),
    "filters": ("concord.filters", "The mathematics of one belief."),
    "topology": ("concord.topology", "Graphs, weights and their analysis."),
}
