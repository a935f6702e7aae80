"""Pages for users, as Markdown; `trust.md` says how far the results of a run can be trusted."""
