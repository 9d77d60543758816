"""Parts shared by several experiments: closed loops, fixed views, cases of the simulated rig."""
