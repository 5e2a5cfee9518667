"""Every reader of files meets damage with an error of the project, in bounded time and memory.

A public function whose name begins with `read_`, `open_` or `load`, and whose first parameter is a
path, is in the table, or a test here fails.
"""

import ast
import importlib
import os
import random
import re
import resource
import runpy
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import networkx
import numpy as np
import pytest
import zstandard
from mcap.records import Chunk
from mcap.writer import Writer

from concord.bus.flexray.cluster_files import cluster_to_toml
from concord.bus.flexray.presets import DEMO
from concord.experiments.cli.command_line import main
from concord.plants.recorded.log_files import open_log
from concord.results.folder import Description
from concord.runtime.network.network_file import NetworkAddresses, write_network
from concord.runtime.recording import read_recording
from concord.studies.sweep.store import save_arrays
from tests.features.flexray_tools.test_signals import arxml, fibex
from tests.house.sources import product

ROOT = Path(__file__).resolve().parent.parent
MOST_MB, MOST_S = 500, 5.0
NO_READER = {
    "studies.sweep.store:open_store",
    "plants.recorded.columns:read_channels",
    "plants.recorded.netcdf:open_netcdf",
    "features.flexray_tools.commands.recordings:read_recorded",
}
"""These make a folder, only call readers of the table, or are called by those alone."""


class Reader(NamedTuple):
    """A reader: the file of the samples that is damaged, and the call on its place."""

    file: str
    call: Callable[[Callable[..., Any], Path], object] = lambda read, file: read(file)


def of_folder(read: Callable[..., Any], file: Path) -> object:
    return read(file.parent)


def of_all(read: Callable[..., Any], file: Path) -> object:
    return list(read(file))


def of_log(read: Callable[..., Any], file: Path) -> None:
    log = read(file)
    for name in log.names:
        log.series(name)
        log.stamps_s(name)


READERS = {
    "results.folder:read_shown": [Reader("run/run.json", of_folder)],
    "results.folder:read_description": [Reader("run/run.json", of_folder)],
    "results.folder:read_description_file": [Reader("run/run.json")],
    "features.hosts.host_place:read_setup": [Reader("run/run.json")],
    "features.hosts.plan:read_plan": [
        Reader("run/hosts.toml"),
        Reader("run/setup.json", lambda read, file: read(file.with_name("hosts.toml"))),
    ],
    "runtime.json_file:read_json": [
        Reader("run/run.json", lambda read, file: read(file, Description, "cure", "wrong"))
    ],
    "runtime.network.network_file:read_network": [Reader("run/network.json", of_folder)],
    "runtime.recording:read_recording": [Reader("run/run.mcap", of_all)],
    "studies.audit.evidence:read_evidence": [
        Reader("run/run.mcap", of_folder),
        Reader("run/run.nc", of_folder),
    ],
    "results.records.netcdf_file:read_dataset": [
        Reader("run/run.nc", lambda read, file: read(file, ("mean",), "cure"))
    ],
    "results.records.netcdf_file:open_dataset": [
        Reader("run/run.nc", lambda read, file: read(file, "cure").close())
    ],
    "experiments.python_api:load": [
        Reader("run/run.nc", lambda read, file: read(file.parent).close())
    ],
    "results.records.runs_file:read_runs": [
        Reader(
            "run/run.nc", lambda read, file: read(file, described(file.with_name("run.json")).setup)
        )
    ],
    "features.flexray_tools.commands.decoded_signals:read_described_signals": [
        Reader("bus.xml"),
        Reader("bus.arxml"),
    ],
    "studies.design.results:read_design": [Reader("design.json")],
    "studies.sweep.results:read_result": [Reader("sweep.nc")],
    "studies.sweep.store:read_begun": [Reader("pieces/sweep.json", of_folder)],
    "studies.sweep.store:load_arrays": [
        Reader("pieces/one.npz", lambda read, file: read(file.parent, "one"))
    ],
    "plants.recorded.log_files:open_log": [
        Reader(f"drive.{kind}", of_log) for kind in ("csv", "nc", "mcap", "ulg")
    ],
    "features.vehicle.plant.drive_log:read_log": [
        Reader("columns.toml", of_folder),
        Reader("drive.csv", of_folder),
    ],
    "features.vehicle.plant.drive_log:read_folder": [Reader("drive.csv", of_folder)],
    "features.vehicle.plant.drive_log:read_car": [Reader("car.toml", of_folder)],
    "features.recorded.mrclam_files:read_recording": [
        Reader("mrclam/Robot1_Groundtruth.dat", of_folder)
    ],
    "features.flexray_tools.recordings.recording_files:read_recording": [
        Reader("drive.csv"),
        Reader("signals.vcd"),
    ],
    "features.flexray_tools.slot_design.demand:read_demand": [Reader("demand.toml")],
    "bus.flexray.cluster_files:read_cluster_file": [Reader("cluster.toml")],
    "bus.flexray.slot_file:read_slot_file": [
        Reader("slots.toml", lambda read, file: read(file, DEMO))
    ],
    "topology.graph_files:read_network": [
        Reader("graph.graphml"),
        Reader("graph.txt"),
        Reader("graph.mtx"),
    ],
    "topology.networkx_files:read_networkx": [Reader("graph.graphml")],
    "topology.edge_lists:read_text": [Reader("graph.txt")],
    "topology.edge_lists:read_market": [Reader("graph.mtx")],
}
CASES = [
    pytest.param(name, reader, id=f"{name} {reader.file}")
    for name, readers in READERS.items()
    for reader in readers
]


def described(file: Path) -> Description:
    return msgspec.json.decode(file.read_bytes(), type=Description)


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole file of each kind."""
    folder = tmp_path_factory.mktemp("samples")
    run(folder, "run", "--steps", "6", "--nodes", "3", "--out", str(folder / "run"))
    shutil.copyfile(folder / "run" / "run.json", folder / "run" / "setup.json")
    hosts = '[hosts.alpha]\naddress = "10.0.0.1"\nnodes = [0, 1, 2]\n'
    (folder / "run" / "hosts.toml").write_text(hosts)
    write_network(folder / "run", NetworkAddresses("run", ["tcp/127.0.0.1:1"], {"0": 1}))
    swept = ("--steps", "6", "--nodes", "3,4", "--runs", "2", "--workers", "1")
    run(folder, "sweep", *swept, "--out", str(folder / "sweep.nc"))
    (folder / "pieces").mkdir()
    specification = b'{"base":{"scenario":"oscillator"},"levels":{"nodes":[3,4]}}'
    begun = b'{"specification":' + specification + b',"versions":{"a":"1"},"commit":null}'
    (folder / "pieces" / "sweep.json").write_bytes(begun)
    save_arrays(folder / "pieces", "one", {"rmse": np.arange(4.0)})
    fields = '"scenario":"oscillator","settled":{"nodes":3},"seed":1,'
    fields += '"target":{"most":1.0,"reference":"unit"},'
    rest = '"unit":"m","minimise":"bytes","tried":[],"refused":[],"attempts":[],"recommended":null'
    text = "{" + fields + rest + ',"finished":true,"versions":{},"commit":null}'
    (folder / "design.json").write_text(text)
    (folder / "bus.xml").write_text(fibex())
    (folder / "bus.arxml").write_text(arxml())
    example = runpy.run_path(str(ROOT / "examples" / "own_log.py"))
    for write in example["WRITERS"].values():
        (folder / "columns.toml").write_text(write(folder, example["signals"](0.3)))
    (folder / "car.toml").write_text(example["CAR"])
    rows = "".join(f"{step / 100:.2f},{step},{step / 7:.3f}\n" for step in range(40))
    (folder / "drive.csv").write_text(f"time,a,b\n{rows}")
    vcd = "$timescale 1 us $end\n$var wire 1 ! a $end\n$enddefinitions $end\n#0\n0!\n#5\n1!\n"
    (folder / "signals.vcd").write_text(vcd)
    (folder / "mrclam").mkdir()
    tables = {"Barcodes": 2, "Landmark_Groundtruth": 5, "Robot1_Groundtruth": 4}
    tables |= {"Robot1_Measurement": 4, "Robot1_Odometry": 3}
    for name, columns in tables.items():
        lines = [" ".join(f"{row + place:.3f}" for place in range(columns)) for row in range(9)]
        (folder / "mrclam" / f"{name}.dat").write_text("\n".join(lines) + "\n")
    (folder / "demand.toml").write_text(
        "[[frames]]\nnode = 0\npayload_bytes = 8\nperiod_us = 5000.0\ndeadline_us = 5000.0\n"
    )
    (folder / "cluster.toml").write_text(cluster_to_toml(DEMO))
    slot = "[[slots]]\nframe_id = 1\npayload_bytes = 16\nnode = 0\n"
    (folder / "slots.toml").write_text(slot)
    ring = networkx.cycle_graph(5)
    networkx.write_graphml(ring, folder / "graph.graphml")
    (folder / "graph.txt").write_text("0 1 0.5\n1 2 0.5\n2 0 1\n")
    market = "%%MatrixMarket matrix coordinate real general\n3 3 4\n1 2 1\n2 1 1\n2 3 1\n3 2 1\n"
    (folder / "graph.mtx").write_text(market)
    return folder


def run(folder: Path, command: str, *words: str) -> None:
    try:
        main([command, "--scenario", "oscillator", *words, "--json"])
    except SystemExit as ended:
        assert ended.code in (None, 0)


def test_the_table_has_all_readers():
    found = set()
    for source in product():
        module = source.module.removeprefix("concord.")
        for one in source.tree.body:
            if not isinstance(one, ast.FunctionDef) or not one.args.args:
                continue
            first = one.args.args[0].annotation
            of_path = first is not None and "Path" in ast.unparse(first)
            if one.name.startswith(("read_", "open_", "load")) and of_path:
                found.add(f"{module}:{one.name}")
    assert found - NO_READER == set(READERS)


def test_hdf5_reads_a_file_in_one_place():
    """It ends the process on some damaged files, so that place looks at a file in a child first."""
    hdf5 = re.compile(r"\b(open_dataset|load_dataset|open_mfdataset|File)$")
    found = {
        source.module
        for source in product()
        for call in ast.walk(source.tree)
        if isinstance(call, ast.Call)
        and hdf5.search(name := ast.unparse(call.func))
        and name.partition(".")[0] in ("xarray", "xr", "h5py", "h5netcdf")
    }
    assert found == {"concord.plants.recorded.netcdf"}


def damaged(content: bytes, chance: random.Random) -> bytes:
    """The content with one of seven damages."""
    data, size = bytearray(content), len(content)
    first = chance.randrange(max(size, 1))
    last = min(size, first + chance.randrange(1, 64))
    match chance.randrange(7):
        case 0:
            for _ in range(chance.randrange(1, 9)):
                data[chance.randrange(size)] ^= 1 << chance.randrange(8)
        case 1:
            del data[first:last]
        case 2:
            data[first:last] = bytes(last - first)
        case 3:
            data[first:first] = data[first:last] * chance.randrange(1, 5)
        case 4:
            del data[first:]
        case 5:
            data[first:first] = chance.randbytes(chance.randrange(1, 64))
        case 6:
            digits = [place for place, byte in enumerate(data) if byte in b"0123456789"]
            place = chance.choice(digits or [first])
            data[place : place + 1] = chance.choice([b"1e12", b"-1", b"999999999999", b"NaN", b""])
    return bytes(data)


@pytest.mark.slow
@pytest.mark.parametrize("mutations", [40, pytest.param(200, marks=pytest.mark.study)])
@pytest.mark.parametrize(("name", "reader"), CASES)
def test_damage_is_met_with_an_error_of_ours(
    name: str, reader: Reader, mutations: int, samples: Path, tmp_path: Path
):
    module, _, function = name.partition(":")
    read = getattr(importlib.import_module(f"concord.{module}"), function)
    folder = tmp_path / "samples"
    shutil.copytree(samples, folder)
    file = folder / reader.file
    whole = file.read_bytes()
    before_mb = peak_mb()
    chance = random.Random(name)
    for number in range(mutations):
        file.write_bytes(b"" if number == 0 else damaged(whole, chance))
        began_s = processor_s()
        try:
            reader.call(read, file)
        except Exception as error:
            of_ours = type(error).__module__.startswith("concord.")
            assert type(error) is ValueError or of_ours, f"mutation {number}: {error!r}"
        assert processor_s() - began_s < MOST_S
    assert peak_mb() - before_mb < MOST_MB


def processor_s() -> float:
    """Processor time of this process and of its children that ended, s."""
    return sum(os.times()[:4])


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def bomb(path: Path, claim: int, compression: str) -> None:
    """An MCAP file of one chunk that unpacks to so many zeros."""
    with path.open("wb") as stream:
        writer: Any = Writer(stream, use_chunking=False)
        writer.start(profile="ros2", library="bomb")
        data = zstandard.compress(bytes(claim))
        chunk = Chunk(compression, data, 0, 0, 0, min(claim, 1000))
        builder = writer._Writer__record_builder
        chunk.write(builder)
        writer.finish()


def test_a_chunk_that_claims_too_much_is_not_unpacked(tmp_path: Path):
    bomb(tmp_path / "drive.mcap", 200_000_000, "zstd")
    before_mb = peak_mb()
    with pytest.raises(ValueError, match=r"a chunk of \d+ bytes unpacks to 200000000"):
        open_log(tmp_path / "drive.mcap")
    with pytest.raises(ValueError, match="it has chunks, as no recording of concord"):
        list(read_recording(tmp_path / "drive.mcap"))
    assert peak_mb() - before_mb < 100
