"""Results: Table 1 cell by cell, what it says about the paper's findings, and what selectors do wrong.

The paper's own figures lie in table1_paper.csv; imports from the core, training and pictures.
In: weights and an evaluation config.  Out: cells, tables, findings, diagnoses.
"""
