"""What a run of any method carries: its plan, its state, its guards and the control of its steps."""
