"""The whole job in a browser: recordings in, margins out, served on this machine alone.

work      what the processes do that a page waits for: the same functions as the commands, results as plain values
jobs      these processes: what is asked at once, what takes long, how far it is, and how it is ended
session   the folder that is worked in: an ordinary campaign folder, its files, sets and devices by id
archive   the folder as one file with checksums, and back
routes    what a page may ask for
server    who may ask, and how a bench begins and ends
"""
