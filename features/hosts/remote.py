"""A command on another host: the user's ssh starts it, and a pipe to ssh keeps it alive."""

import io
import shlex
import subprocess
import tarfile
from contextlib import suppress

from concord.features.hosts.plan import KEYS, SETUP, NetworkPlan, Process

# The first line of each command: ssh has let us in.
HERE = "concord-up: here"
# The shell of the other host reads a line, which kills the command at once, or the end of this
# process, which ends the command in order. ssh alone would leave the command running.
_KEPT_ALIVE = """cd {folder} || exit 2
exec 3<&0
{command} </dev/null 3<&- &
child=$!
{{ if read -r word <&3; then kill -KILL $child; else kill -TERM $child; fi; }} >/dev/null 2>&1 &
watch=$!
echo '{here}' >&2
wait $child
code=$?
kill $watch 2>/dev/null
exit $code
"""


def remote_folder(plan: NetworkPlan) -> str:
    """Return the folder of a run on each host, below the user's home."""
    return f"concord-{plan.run}"


def copy_files(plan: NetworkPlan, host: str) -> None:
    """Copy setup and keys to a host.

    Raises:
        ValueError: ssh does not reach the host, or concord is missing there.
    """
    files = {SETUP: plan.setup, **{f"{KEYS}/{path.name}": path for path in plan.keys[host]}}
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as tar:
        for name, path in files.items():
            entry = tarfile.TarInfo(name)
            data = path.read_bytes()
            entry.size, entry.mode = len(data), 0o600
            tar.addfile(entry, io.BytesIO(data))
    folder, program = shlex.quote(remote_folder(plan)), shlex.quote(plan.hosts[host].concord)
    found = f"command -v {program} >/dev/null || {{ echo {program} not found >&2; exit 1; }}"
    unpack = f"{found}; umask 077; mkdir -p {folder} && tar -xf - -C {folder}"
    try:
        done = subprocess.run(
            _ssh(plan, host, unpack), input=archive.getvalue(), capture_output=True, check=False
        )
    except FileNotFoundError:
        raise ValueError("ssh: there is no such program; install OpenSSH's client") from None
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip().splitlines() or ["no word"]
        raise ValueError(
            f"host {host}: ssh {_destination(plan, host)} ended with exit code {done.returncode} "
            f"({said[-1]}); mend that host or its entry, then start again"
        )


def _destination(plan: NetworkPlan, host: str) -> str:
    return plan.hosts[host].ssh or plan.hosts[host].address


def _ssh(plan: NetworkPlan, host: str, script: str) -> list[str]:
    """Return the command that runs a script on a host; nobody can answer a question of ssh."""
    command = f"sh -c {shlex.quote(script)}"
    return ["ssh", "-T", "-o", "BatchMode=yes", "--", _destination(plan, host), command]


class Remote:
    """A running command on a host, and what it has said of a line that is not complete."""

    def __init__(self, plan: NetworkPlan, process: Process) -> None:
        self.process, self._partial = process, b""
        self.is_here = False
        program = plan.hosts[process.host].concord
        script = _KEPT_ALIVE.format(
            folder=shlex.quote(remote_folder(plan)),
            command=shlex.join([program, *process.words]),
            here=HERE,
        )
        self.ssh = subprocess.Popen(
            _ssh(plan, process.host, script),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            # Ctrl-C is for us, who end all commands in order.
            start_new_session=True,
        )

    @property
    def title(self) -> str:
        """The name in front of each of its lines."""
        return f"{self.process.host} {self.process.name}"

    def lines(self, data: bytes) -> list[str]:
        """Return the complete lines, without the one that says that the command is there."""
        *lines, self._partial = (self._partial + data).split(b"\n")
        words = [line.decode(errors="replace").rstrip("\r") for line in lines]
        if HERE in words:
            self.is_here = True
            words.remove(HERE)
        return words

    def rest(self) -> list[str]:
        """Return what stands behind the last complete line."""
        return self.lines(b"\n") if self._partial else []

    def kill(self) -> None:
        """End the command at once, without its knowledge."""
        self._tell(b"kill\n")

    def end(self) -> None:
        """Ask the command to end, as Ctrl-C does."""
        self._tell(b"")

    def _tell(self, word: bytes) -> None:
        assert self.ssh.stdin is not None
        # The command, or ssh, may have ended already.
        with suppress(BrokenPipeError):
            if not self.ssh.stdin.closed:
                self.ssh.stdin.write(word)
                self.ssh.stdin.close()
