"""What a user would pick instead, side by side: ``python -m tests.benchmark``.

Medians of repetitions in turns, so that the noise of the machine hits all alike. Costs
are CPU seconds of all threads and child processes.
"""
