"""Where `concord` begins: what must be settled before anything is loaded."""

import os
import signal


def main(
    arguments: list[str] | None = None, program: str = "", preset: dict[str, str] | None = None
) -> None:
    """Load the command line and run it."""
    # Before anything imports numpy: results must not depend on how many threads share a sum.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # While we load there is nothing to clean up, and a traceback would tell nobody anything; when
    # the command is loaded, Ctrl-C is an exception again.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from concord.experiments.cli.command_line import main as run_command_line

    run_command_line(arguments, program, preset)


if __name__ == "__main__":
    main()
