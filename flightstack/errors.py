"""The one error that is a user's: apart from the types, so that whoever only reports it needs no numpy."""


class InputError(ValueError):
    """Bad input of a user: a file, a key, an argument.  Its text is one line that says what is wrong and what to do."""
