"""Running a method on a dataset under a protocol, and the result that it leaves.

Nothing is imported here: the command line reads `dofbench.evaluation.results.run_spec` alone.
"""
