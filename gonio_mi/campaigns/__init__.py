"""Many directions of many specimens: tasks, folders, workers."""
