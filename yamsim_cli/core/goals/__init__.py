"""When a task is done: predicates over the world, each with its margin in numbers, and goals made of them."""
