"""The steps of the data check, one concern a file; `gap.check` calls them in order."""
