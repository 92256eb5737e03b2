"""One module a subject; see the package's text."""
