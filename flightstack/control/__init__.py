"""Controllers: measurement and reference to thrust and body rates; state explicit, `init` and `step`."""
