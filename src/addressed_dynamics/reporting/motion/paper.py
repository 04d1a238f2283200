"""What the paper reports on motion capture, and whose data and model it is compared with."""

from addressed_dynamics.reporting.common.paper import CITATION

PAPER_OWN, PAPER_PFNN = 0.69, 2.21
"""Mean absolute error of the paper's model and of PFNN (Experiment 3), in a unit that it does not state."""
PAPER_ROWS = 40_000
"""Frames of its test set, drawn from all."""
SOURCES = (
    CITATION,
    "Holden, Komura, Saito: Phase-Functioned Neural Networks for Character Control. ACM Transactions on Graphics 36 "
    "(SIGGRAPH 2017): the layout of inputs and outputs, PFNN itself, and the controller of the closed loop.",
    "Zhang, Starke, Komura, Saito: Mode-Adaptive Neural Networks for Quadruped Motion Control. ACM Transactions on "
    "Graphics 37 (SIGGRAPH 2018): the network whose parameters a gate mixes.",
)
"""What the experiment rests on."""
