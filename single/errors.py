"""The one family of errors that quadrig raises on purpose."""


class QuadrigError(Exception):
    """Something a person can mend: the message is one sentence that says what, where, and what to do."""
