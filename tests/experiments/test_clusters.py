"""Sweeps on clusters: the files of `deploy/` for shards, and Dask with TLS and with losses."""

import datetime
import gc
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from concord.experiments.__main__ import main
from concord.studies.sweep.dask_workers import connect
from concord.studies.sweep.merge import merge_shards
from concord.studies.sweep.results import read_result
from concord.studies.sweep.run import Shard, begin, finish
from concord.studies.sweep.specification import specify
from concord.studies.sweep.store import folder_of
from concord.studies.sweep.workers import WorkerLost
from tests.experiments.units import DEPLOY
from tests.processes import PATIENCE_S, family

WORDS = [
    "--scenario", "oscillator", "--nodes", "3", "--steps", "8", "--seed", "1..4",
    "--runs", "2", "--keep", "moments",
]  # fmt: skip
ASKED = {"scenario": "oscillator", "nodes": "3", "steps": "8", "seed": "1..4"}
# As sbatch does for an array: a job each, with the words behind the file and these variables.
SBATCH = """#!/bin/sh
set -e
for number in $NUMBERS; do
    SLURM_ARRAY_TASK_ID=$number SLURM_ARRAY_TASK_COUNT=3 SLURM_CPUS_PER_TASK=1 sh "$@"
done
"""


# As sbatch does for a job: it copies the file, says the number, and runs the copy later.
SBATCH_OF_ONE = """#!/bin/sh
cp "$1" job.sh
echo "Submitted batch job 7"
setsid sh job.sh > job.log 2>&1 &
echo $! > job.pid
"""
SCANCEL = """#!/bin/sh
echo "$@" > cancelled
kill -- -"$(cat job.pid)"
"""


def stand_in(folder: Path, **programs: str) -> dict[str, str]:
    """Return the environment in which these programs are found first."""
    for name, text in programs.items():
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    return {**os.environ, "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}


@pytest.fixture(autouse=True)
def _no_old_clients(request: pytest.FixtureRequest) -> None:
    """A client of an earlier test closes as it is collected: not while the next one starts.

    Only tests that are marked as slow start clients.
    """
    if "slow" in request.keywords:
        gc.collect()


@pytest.mark.slow
def test_an_array_of_jobs_is_the_undivided_sweep(tmp_path: Path):
    program = f'#!/bin/sh\nexec {sys.executable} -m concord.experiments "$@"\n'
    environment = stand_in(tmp_path, sbatch=SBATCH, concord=program)
    numbers = random.Random(2).sample(range(1, 4), 3)
    assert numbers != sorted(numbers)
    subprocess.run(
        ["sbatch", DEPLOY / "shards.sh", *WORDS],
        env={**environment, "NUMBERS": " ".join(map(str, numbers)), "SHARDS": "3"},
        cwd=tmp_path, check=True, capture_output=True,
    )  # fmt: skip
    folders = [str(tmp_path / f"shard{number}.nc.pieces") for number in numbers]
    main(["merge", *folders, "-o", str(tmp_path / "merged.nc")])
    main(["sweep", *WORDS, "--workers", "1", "-o", str(tmp_path / "whole.nc")])
    assert read_result(tmp_path / "merged.nc").identical(read_result(tmp_path / "whole.nc"))


def test_one_of_ten_shards_is_submitted_again_by_its_number(tmp_path: Path):
    environment = stand_in(tmp_path, concord='#!/bin/sh\necho "$@"\n')
    for number in (7, 3):
        again = {"SLURM_ARRAY_TASK_ID": str(number), "SLURM_ARRAY_TASK_COUNT": "1"}
        said = subprocess.run(
            ["sh", DEPLOY / "shards.sh", *WORDS], env={**environment, **again},
            cwd=tmp_path, check=True, capture_output=True, text=True,
        ).stdout  # fmt: skip
        assert f"--shard {number}/10 --out shard{number}.nc" in said


def test_pieces_of_another_number_of_shards_are_refused(tmp_path: Path):
    specification, out = specify(ASKED, runs=2), tmp_path / "shard2.nc"
    begin(specification, out, shard=Shard(2, 3))
    assert begin(specification, out, shard=Shard(2, 3)).folder == folder_of(out)
    with pytest.raises(ValueError, match="begun with 3 shards, and now 1 are asked for"):
        begin(specification, out)
    begin(specification, tmp_path / "other.nc", shard=Shard(1, 2))
    with pytest.raises(ValueError, match=r"one of 2 shards, and .* one of 3"):
        merge_shards([folder_of(out), folder_of(tmp_path / "other.nc")], tmp_path / "all.nc")


@pytest.mark.slow
def test_a_sweep_waits_for_the_first_worker_of_dask(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=0, processes=False, dashboard_address=None, protocol="tcp://", host="127.0.0.1"
    ) as cluster:
        address = cluster.scheduler_address
        with pytest.raises(ValueError, match=r"no workers after 0\.2 s"):
            connect(address, wait_s=0.2)
        assert "waiting for workers" in capsys.readouterr().err
        # The worker starts only when the sweep says that it waits.
        late, said = threading.Timer(0.5, lambda: cluster.scale(1)), []

        def say(text: str) -> None:
            said.append(text)
            late.start()

        with monkeypatch.context() as patch:
            patch.setattr("sys.stderr.write", say)
            compute = connect(address, wait_s=60)
        late.join()
        found = finish(begin(specify(ASKED, runs=2), None), compute, lambda _: None)
    assert found.computed_pieces == 4
    assert len(said) == 1 and "waiting for workers" in said[0]


def test_the_job_of_kubernetes_is_valid_and_computes_shards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    validator = pytest.importorskip("kubernetes_validate", reason="of the development group")
    yaml = pytest.importorskip("yaml", reason="comes with kubernetes-validate")
    job = yaml.safe_load((DEPLOY / "kubernetes-shards.yaml").read_text())
    validator.validate(job, "1.33", strict=True)
    assert job["spec"]["completions"] == 10 and job["spec"]["completionMode"] == "Indexed"
    [container] = job["spec"]["template"]["spec"]["containers"]
    # The shell of the pod, with a program that prints its words.
    environment = stand_in(tmp_path, concord='#!/bin/sh\necho "$@"\n')
    said = subprocess.run(
        [*container["command"], *container["args"]],
        env={**environment, "JOB_COMPLETION_INDEX": "9"},
        check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    words = said.split()
    assert words[:3] == ["sweep", "--scenario", "oscillator"] and "10/10" in words
    monkeypatch.chdir(tmp_path)
    words[words.index("--runs") + 1] = "2"
    short = ["--nodes", "3", "--steps", "8", "--seed", "1..10"]
    main([*words, *short])
    assert len([*(tmp_path / "shard10.nc.pieces").glob("*.npz")]) == 1


@pytest.mark.slow
def test_the_dask_cluster_of_kubernetes_is_valid_and_computes_a_sweep(tmp_path: Path):
    distributed = pytest.importorskip("distributed")
    validator = pytest.importorskip("kubernetes_validate", reason="of the development group")
    yaml = pytest.importorskip("yaml", reason="comes with kubernetes-validate")
    cluster = yaml.safe_load((DEPLOY / "dask-kubernetes.yaml").read_text())
    scheduler, worker = (cluster["spec"][name] for name in ("scheduler", "worker"))
    head = {"apiVersion": "v1", "metadata": {"name": "one"}}
    for kind, spec in (("Pod", scheduler["spec"]), ("Pod", worker["spec"]),
                       ("Service", scheduler["service"])):  # fmt: skip
        validator.validate({**head, "kind": kind, "spec": spec}, "1.33", strict=True)
    selector = scheduler["service"]["selector"]
    assert selector["dask.org/cluster-name"] == cluster["metadata"]["name"]
    place = tmp_path / "scheduler.json"
    first, second = (pod["spec"]["containers"][0]["args"] for pod in (scheduler, worker))
    free = ["--host", "127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0"]
    processes = [_started([*first, *free, "--scheduler-file", str(place)], {})]
    try:
        address = _address_in(place)
        own = ["one" if word == "$(DASK_WORKER_NAME)" else word for word in second]
        own[own.index("/tmp")] = str(tmp_path)
        processes.append(_started(own, {"DASK_SCHEDULER_ADDRESS": address}))
        with distributed.Client(address, timeout=60) as client:
            client.wait_for_workers(1, timeout=60)
        begun = begin(specify(ASKED, runs=2), None)
        found = finish(begun, connect(address), lambda _: None)
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.wait(30)
    assert found.computed_pieces == 4 and found.dataset is not None


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("setsid") is None, reason="setsid comes with util-linux")
def test_jobs_of_slurm_are_workers_until_ctrl_c(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("dask_jobqueue", reason="of the development group")
    distributed = pytest.importorskip("distributed")
    environment = stand_in(tmp_path, sbatch=SBATCH_OF_ONE, scancel=SCANCEL)
    monkeypatch.setenv("PATH", environment["PATH"])
    with family([sys.executable, str(DEPLOY / "dask_slurm.py"), "1"], tmp_path) as cluster:
        address = cluster.await_output(lambda line: line.startswith("tcp://")).strip()
        with distributed.Client(address, timeout=60) as client:
            client.wait_for_workers(4, timeout=120)
        found = finish(begin(specify(ASKED, runs=2), None), connect(address), lambda _: None)
        cluster.send(signal.SIGINT)
        code, _, said = cluster.end(PATIENCE_S)
    assert found.computed_pieces == 4 and found.dataset is not None
    assert code == 0 and "Traceback" not in said
    assert (tmp_path / "cancelled").read_text() == "7\n"


def _started(words: list[str], more: dict[str, str]) -> subprocess.Popen[bytes]:
    """Start a command of a pod, `dask ...`, by this interpreter."""
    program = [sys.executable, "-m", *words]
    quiet = subprocess.DEVNULL
    return subprocess.Popen(program, env={**os.environ, **more}, stdout=quiet, stderr=quiet)


def _address_in(file: Path) -> str:
    """Return the address that a scheduler writes when it is ready."""
    for _ in range(600):
        if file.exists() and (text := file.read_text()).strip().endswith("}"):
            return json.loads(text)["address"]
        time.sleep(0.1)
    raise AssertionError("the scheduler did not start within a minute")


def certificates(folder: Path) -> None:
    """Write an authority, and a certificate of its for all ends of a connection."""
    x509 = pytest.importorskip("cryptography.x509", reason="the extra secure makes certificates")
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.oid.NameOID.COMMON_NAME, "dask")])
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now - datetime.timedelta(hours=1))
        .not_valid_after(now + datetime.timedelta(hours=1))
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
        .public_bytes(serialization.Encoding.PEM)
    )
    (folder / "ca.pem").write_bytes(certificate)
    (folder / "cert.pem").write_bytes(certificate)
    (folder / "key.pem").write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
    )


@pytest.mark.slow
def test_workers_behind_tls_find_the_same_and_others_are_refused(tmp_path: Path):
    distributed = pytest.importorskip("distributed")
    dask_settings = pytest.importorskip("dask").config
    certificates(tmp_path)
    ca, cert, key = (str(tmp_path / name) for name in ("ca.pem", "cert.pem", "key.pem"))
    ends = {f"tls_{end}_{part}": path for end in ("client", "scheduler", "worker")
            for part, path in (("cert", cert), ("key", key))}  # fmt: skip
    security = distributed.Security(tls_ca_file=ca, require_encryption=True, **ends)
    specification = specify(ASKED, runs=2)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, security=security,
        protocol="tls://", local_directory=str(tmp_path), processes=False,
    ) as cluster:  # fmt: skip
        address = cluster.scheduler_address
        assert address.startswith("tls://")
        with pytest.raises(ValueError, match="give --dask-tls FOLDER") as _refused:
            connect(address)
        # A client that is collected while the next one starts waits for a lock of that start.
        assert not any(isinstance(one, distributed.Client) for one in gc.get_objects())
        engine = connect(address, tmp_path)
        # A default client would stay in these settings where clients overlap.
        assert dask_settings.get("scheduler", None) is None
        found = finish(begin(specification, None), engine, lambda _: None)
    here = tmp_path / "here.nc"
    main(["sweep", *WORDS[:-2], "--keep", "histories", "--workers", "1", "-o", str(here)])
    assert found.dataset is not None and found.dataset.equals(read_result(here))


def test_files_of_tls_are_named(tmp_path: Path):
    with pytest.raises(ValueError, match=r"has no file ca\.pem"):
        connect("tls://127.0.0.1:1", tmp_path)
    with pytest.raises(ValueError, match="such as tls://HOST:8786"):
        connect("tcp://127.0.0.1:1", tmp_path)


@pytest.mark.study
def test_a_lost_scheduler_is_one_line_with_the_command_that_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    distributed = pytest.importorskip("distributed")
    out = tmp_path / "s.nc"
    words = ["sweep", *WORDS, "-o", str(out), "--dask"]
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, protocol="tcp://",
        local_directory=str(tmp_path), processes=False,
    ) as cluster:  # fmt: skip
        words.append(cluster.scheduler_address)
        monkeypatch.setattr(sys, "argv", ["concord", *words])

        def lose(*_: object) -> None:
            cluster.sync(cluster.scheduler.close)

        monkeypatch.setattr("concord.studies.sweep.run.save_arrays", lose)
        with pytest.raises(SystemExit) as end:
            main(words)
    said = capsys.readouterr().err
    assert end.value.code == 1 and "Traceback" not in said
    [line] = [line for line in said.splitlines() if line.startswith("concord: ")]
    assert "scheduler does not answer" in line
    assert line.endswith(f"go on with: concord {' '.join(words)}")


@pytest.mark.slow
def test_a_scheduler_that_stays_without_workers_ends_the_sweep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("concord.studies.sweep.dask_workers._WITHOUT_WORKERS_S", 2.0)
    monkeypatch.setattr("concord.studies.sweep.dask_workers._LOOK_EVERY_S", 1.0)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, protocol="tcp://",
        local_directory=str(tmp_path), processes=False,
    ) as cluster:  # fmt: skip
        engine = connect(cluster.scheduler_address)
        cluster.scale(0)
        with pytest.raises(WorkerLost, match="without workers"):
            list(engine(abs, [-1, -2]))
