"""The paper's planner, `pouct_paper`: Algorithm 1 on beliefs inside PO-UCT."""
