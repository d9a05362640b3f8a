"""What all tests need, wherever they run."""

import signal

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell's background job: what tests start could not be interrupted
    signal.signal(signal.SIGINT, signal.default_int_handler)
