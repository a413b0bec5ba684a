"""What can go wrong, as a sentence with its remedy and an exit code."""

# Exit codes of boresight-cluster, and what they mean to whoever tries again: those of the program, docs/formats.md.
DONE, FAILED, NEVER, NO = 0, 1, 2, 3


class ClusterError(Exception):
    """A failure that may pass: the same work is worth another try."""

    code = FAILED


class NeverError(ClusterError):
    """A failure that no further try mends."""

    code = NEVER


def last_line(text: str) -> str:
    """The last line that is not empty, for a message: where the program says what was wrong."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "it said nothing"
