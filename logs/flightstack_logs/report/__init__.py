"""The HTML report of a flight: one self-contained page that opens from disk.

`log_input.from_log(log, result)` gathers what a log holds, `page.write_report(flight, path)` writes the page.
"""
