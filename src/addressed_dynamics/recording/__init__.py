"""Recording an agent: the wrapper that logs every step, the behaviours that act, and the plan that runs them in order.

Nothing is imported here, so that the recorder can be had without PyTorch.
"""
