"""How far a result can be trusted: the criteria of verdicts, and the numbers they are applied to."""
