"""What the commands and the Python interface do: the rooms of the method strung together, one chapter a task.

resume     what is there already: fits and margins that stand, earlier posteriors as priors
device     one device: read, fit or diagnose, write, draw; simulated devices, and what they show of the installation
manifest   what a campaign is to do
campaign   many devices, and what they say together
design     population, comparison, margins, files for structural analysis
plan       which test next
"""
