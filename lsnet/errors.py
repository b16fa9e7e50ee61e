"""What the detector tells its user, one line each."""


class LSNetError(Exception):
    """Raised when weights, images or training data cannot be used; the message says what to do."""
