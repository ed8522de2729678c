"""The one exception for wrong input: a single plain sentence."""


class InputError(ValueError):
    """Input that is refused; the message names file, row or key, what was found and what is allowed, in one line."""

    def __init__(self, message: str):
        super().__init__(" ".join(message.splitlines()))
