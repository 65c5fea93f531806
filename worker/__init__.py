"""What to bake next, and baking it: the queue, the tasks, and the processes that do them."""
