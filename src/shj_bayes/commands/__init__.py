"""What the commands and the Python interface do: one file a task, strung together from the rooms of the method.

options        how a device is read and fitted
pipeline       one device: read, fit or diagnose, write, draw
campaign       many devices; summary pools them, or the published tables
design         margins and files for structural analysis
comparison     two sets held against each other
simulated      recordings with a known truth
validation     the one door to `shj_validation`
finished, earlier, mistaken: results that are there already, as answers, as priors, as slips; doctor, examples
"""
