"""The packaged study `contact`: compares the treatments of contacts on motions with closed-form solutions."""
