"""Many runs of one call: planned, made in processes of their own, resumed, and counted.

Nothing is imported here: the command line reads `dofbench.running.run_options` alone.
"""
