"""``python -m ros2_fallback`` is the ``ros2`` command."""

import signal

# Until a command says how it wants to be stopped, Ctrl-C ends the process without a trace of what it was importing.
# Left alone where whoever started us wants it ignored.
if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from ros2_fallback.cli import entry

if __name__ == "__main__":
    entry()
