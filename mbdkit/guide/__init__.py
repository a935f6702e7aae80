"""Pages for users, as Markdown: `trust.md` on the results of a run, `reliability.md` on files, kills and strangers."""
