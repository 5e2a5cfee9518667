"""From frames on a FlexRay bus to an estimate: a log of frames, its description, and a model.

Usage: python examples/bus_signals.py [FOLDER]. Two nodes of a vehicle send its speed, as counts of
0.01 m/s in the slots 3 and 5. The commands in docs/bus.md take the files from there.
"""

import struct
import sys
from pathlib import Path

import numpy as np

from concord.features.flexray_tools.api import MessageSlot, cluster_to_fibex, preset

STEP_S, STEPS, NOISE = 0.02, 200, (0.05, 0.1)
MODEL = '''"""A vehicle whose speed drifts, seen by two nodes on its bus."""

from pathlib import Path

import concord as cc

PLANT = cc.OwnPlant(
    f=lambda x: x, Q=[0.01], mean=[20.0], cov=[9.0],
    state_names=("speed",), state_units=("m/s",), time_step_s=0.02,
)
SENSORS = [
    cc.OwnSensor(h=lambda x: x, R=std**2, name=name, channels=(("v", "m/s"),))
    for name, std in (("front", 0.05), ("rear", 0.1))
]
VEHICLE = cc.own_scenario(
    PLANT, SENSORS, readings=Path(__file__).with_name("drive.csv"), graph="path"
)
'''
PDUS = """
    <fx:PDUS>{pdus}
    </fx:PDUS>
    <fx:SIGNALS>{signals}
    </fx:SIGNALS>
  </fx:ELEMENTS>
  <fx:PROCESSING-INFORMATION>
    <ho:UNIT-SPEC><ho:UNIT ID="speed"><ho:SHORT-NAME>speed</ho:SHORT-NAME>
      <ho:DISPLAY-NAME>m/s</ho:DISPLAY-NAME></ho:UNIT></ho:UNIT-SPEC>
    <fx:CODINGS><fx:CODING ID="hundredths"><ho:SHORT-NAME>hundredths</ho:SHORT-NAME>
      <ho:CODED-TYPE ho:BASE-DATA-TYPE="A_UINT16" ho:ENCODING="UNSIGNED">
        <ho:BIT-LENGTH>16</ho:BIT-LENGTH></ho:CODED-TYPE>
      <ho:COMPU-METHODS><ho:COMPU-METHOD><ho:SHORT-NAME>hundredths</ho:SHORT-NAME>
        <ho:CATEGORY>LINEAR</ho:CATEGORY><ho:UNIT-REF ID-REF="speed"/>
        <ho:INTERNAL-CONSTRS><ho:SCALE-CONSTR VALIDITY="NOT-AVAILABLE">
          <ho:LOWER-LIMIT>65535</ho:LOWER-LIMIT><ho:UPPER-LIMIT>65535</ho:UPPER-LIMIT>
        </ho:SCALE-CONSTR></ho:INTERNAL-CONSTRS>
        <ho:COMPU-INTERNAL-TO-PHYS><ho:COMPU-SCALES><ho:COMPU-SCALE><ho:COMPU-RATIONAL-COEFFS>
          <ho:COMPU-NUMERATOR><ho:V>0</ho:V><ho:V>1</ho:V></ho:COMPU-NUMERATOR>
          <ho:COMPU-DENOMINATOR><ho:V>100</ho:V></ho:COMPU-DENOMINATOR>
        </ho:COMPU-RATIONAL-COEFFS></ho:COMPU-SCALE></ho:COMPU-SCALES></ho:COMPU-INTERNAL-TO-PHYS>
      </ho:COMPU-METHOD></ho:COMPU-METHODS></fx:CODING></fx:CODINGS>
  </fx:PROCESSING-INFORMATION>"""
PDU = """
      <fx:PDU ID="pdu_{name}"><ho:SHORT-NAME>pdu_{name}</ho:SHORT-NAME>
        <fx:BYTE-LENGTH>4</fx:BYTE-LENGTH><fx:SIGNAL-INSTANCES>
          <fx:SIGNAL-INSTANCE ID="in_{name}"><fx:BIT-POSITION>0</fx:BIT-POSITION>
            <fx:IS-HIGH-LOW-BYTE-ORDER>false</fx:IS-HIGH-LOW-BYTE-ORDER>
            <fx:SIGNAL-REF ID-REF="{name}"/></fx:SIGNAL-INSTANCE>
        </fx:SIGNAL-INSTANCES></fx:PDU>"""
SIGNAL = """
      <fx:SIGNAL ID="{name}"><ho:SHORT-NAME>{name}</ho:SHORT-NAME>
        <fx:CODING-REF ID-REF="hundredths"/></fx:SIGNAL>"""
INSTANCE = """<fx:PDU-INSTANCES><fx:PDU-INSTANCE ID="of_{name}"><fx:PDU-REF ID-REF="pdu_{name}"/>
        <fx:BIT-POSITION>16</fx:BIT-POSITION></fx:PDU-INSTANCE></fx:PDU-INSTANCES></fx:FRAME>"""


def description() -> str:
    """Return the FIBEX document: the cluster of a car, two frames, and a signal in each."""
    sent = {"front_v": 3, "rear_v": 5}
    slots = [MessageSlot(frame_id=one, payload_bytes=8) for one in sent.values()]
    text = cluster_to_fibex(preset("audi"), slots)
    for name, one in sent.items():
        at = text.index("</fx:FRAME>", text.index(f'ID="frame_{one}_0_1_A"'))
        text = text[:at] + INSTANCE.format(name=name) + text[at + len("</fx:FRAME>") :]
    written = PDUS.format(
        pdus="".join(PDU.format(name=name) for name in sent),
        signals="".join(SIGNAL.format(name=name) for name in sent),
    )
    return text.replace("</fx:ELEMENTS>", written)


def frames(seed: int = 1) -> str:
    """Return the log: a line for each frame, with the speed in bytes 2 and 3 of its payload."""
    generator = np.random.default_rng(seed)
    speed = 20.0 + np.cumsum(0.1 * generator.standard_normal(STEPS))
    lines = ["time_s,channel,frame_id,cycle,payload"]
    for step in range(STEPS):
        for frame_id, std in zip((3, 5), NOISE, strict=True):
            count = round(100 * (speed[step] + std * generator.standard_normal()))
            if step % 50 == 49:  # not available
                count = 65535
            payload = bytes(2) + struct.pack("<H", count) + bytes(4)
            at_s = step * STEP_S + frame_id * 60e-6
            lines.append(f"{at_s:.6f},A,{frame_id},{4 * step % 64},{payload.hex()}")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the three files."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/bus_signals")
    folder.mkdir(parents=True)
    for name, text in (
        ("frames.csv", frames()), ("bus.xml", description()), ("vehicle.py", MODEL)
    ):  # fmt: skip
        (folder / name).write_text(text)
        sys.stdout.write(f"{folder / name}\n")


if __name__ == "__main__":
    main()
