"""What the verbs' exit codes mean (docs: the contract's section 2)."""

OK, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
