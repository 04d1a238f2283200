"""The command line."""

from addressed_dynamics.base.interrupts import say_nothing_of_interrupts

# `main` speaks of Ctrl-C, but only once its imports are done, which may take seconds.
say_nothing_of_interrupts()
