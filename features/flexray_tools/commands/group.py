"""`concord flexray`: recordings, clusters and plans of a FlexRay bus.

Reason for a file of its own: an entry names it.
"""

from concord.features.flexray_tools.commands.clock_runs import clocks
from concord.features.flexray_tools.commands.clusters import validate
from concord.features.flexray_tools.commands.conversion import convert
from concord.features.flexray_tools.commands.frame_logs import spare, statistics
from concord.features.flexray_tools.commands.plans import plan, show
from concord.features.flexray_tools.commands.recordings import decode, fit
from concord.features.flexray_tools.commands.response_times import wcrt
from concord.features.flexray_tools.commands.slot_designs import design_slots_command
from concord.features.flexray_tools.commands.turn_designs import design_turns_command

SUMMARY = "Recordings, clusters and plans of a FlexRay bus."
COMMANDS = {
    "decode": decode,
    "fit": fit,
    "statistics": statistics,
    "spare": spare,
    "validate": validate,
    "plan": plan,
    "show": show,
    "wcrt": wcrt,
    "clocks": clocks,
    "design-slots": design_slots_command,
    "design-turns": design_turns_command,
    "convert": convert,
}
