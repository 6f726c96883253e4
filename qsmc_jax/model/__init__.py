"""What is controlled, what it should follow, and what disturbs it."""
