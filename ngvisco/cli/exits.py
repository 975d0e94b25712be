"""Exit codes of the command ``ngvisco``."""

DONE = 0
FAILED = 1  # a step could not be solved
BAD_INPUT = 2  # the case or an option is at fault, or there are results already
BAD_FILE = 3  # a file could not be read or written
NOT_CLOSED = 4  # the run reached its end, but its energy ledger does not close
INTERRUPTED = 130  # 128 + n: stopped by signal n, with a checkpoint
