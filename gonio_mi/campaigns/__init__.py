"""Many directions of many specimens: tasks, folders, workers, and choosing them."""
