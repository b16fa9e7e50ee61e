"""The error that this package raises for input it cannot use."""

from __future__ import annotations

MAX_HEAD, MAX_TAIL = 700, 250  # characters of a long message


class LSNetError(Exception):
    """Raised when weights, images or training data cannot be used.

    The message is one line that names the file and says what to do. Long ones are cut in the middle: names
    and reasons can come from damaged files.
    """

    def __str__(self) -> str:
        text = super().__str__().replace("\n", " ")
        if len(text) <= MAX_HEAD + MAX_TAIL:
            return text
        return f"{text[:MAX_HEAD]} ... {text[-MAX_TAIL:]}"
