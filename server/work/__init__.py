"""The worker: takes work off the queues and runs each stage as one process."""
