"""A page in the browser that shows a hand in three dimensions."""
