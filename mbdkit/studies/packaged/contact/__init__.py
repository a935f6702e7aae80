"""The packaged study `contact`: the treatments of contacts on motions with closed forms."""
