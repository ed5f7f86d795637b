"""What cannot be exported, as exceptions."""

__all__ = ["TooLarge", "Unsupported"]


class Unsupported(ValueError):
    """A law is written with something that cannot be exported; the message says what, and where."""


class TooLarge(Unsupported):
    """A program has more numbers in its tables than is allowed."""
