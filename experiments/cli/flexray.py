"""`concord flexray`: recordings, clusters and plans of a FlexRay bus."""

from concord.experiments.flexray.clock_runs import clocks
from concord.experiments.flexray.clusters import validate
from concord.experiments.flexray.conversion import convert
from concord.experiments.flexray.plans import plan, show
from concord.experiments.flexray.recordings import decode, fit
from concord.experiments.flexray.response_times import wcrt
from concord.experiments.flexray.slot_designs import design_slots_command
from concord.experiments.flexray.turn_designs import design_turns_command

SUMMARY = "Recordings, clusters and plans of a FlexRay bus."
COMMANDS = {
    "decode": decode,
    "fit": fit,
    "validate": validate,
    "plan": plan,
    "show": show,
    "wcrt": wcrt,
    "clocks": clocks,
    "design-slots": design_slots_command,
    "design-turns": design_turns_command,
    "convert": convert,
}
