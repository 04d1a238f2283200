"""The contract: episodes of transitions or of motion, the tables that they are kept in, and what is counted of them."""
