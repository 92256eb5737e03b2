"""The one error that is a user's: apart from the types, so that whoever only reports it needs no numpy."""


class InputError(ValueError):
    """Bad input of a user: a file, a key, an argument.  Its text is one line that says what is wrong and what to do."""


def one_line(text: str) -> str:
    """The text on one line; what a file puts into it moves no cursor, colours nothing and hides nothing."""
    words = " ".join(text.split())
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in words)
