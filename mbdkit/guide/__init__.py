"""Pages for users, as Markdown files; `mbdkit guide` lists them."""
