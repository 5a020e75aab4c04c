"""How good the synthesis is: data sets with true frames, methods to compare, records of what was measured, reports."""
