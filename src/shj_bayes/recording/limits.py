"""Every threshold of the readers and checks in one place, with the reason for its value."""

# --- what may be read: a laboratory recording is at most some hundred megabytes; more is a mistake or an attack ---
MAX_ROWS = 10_000_000
MAX_COLUMNS = 512
MAX_BYTES = 512 * 1024**2  # after decompression; holds 10 million rows of four numbers as text
MAX_JSON_BYTES = 64 * 1024**2  # parsed it takes ten times as much memory: a million rows of three numbers
CHUNK_BYTES = 4 * 1024**2  # a compressed file is unpacked in pieces of this size, so that it can be stopped
BLOCK_ROWS = 200_000  # rows of text held at a time: some 50 MB, however long the file
HDF5_SECONDS = 20  # for a small file on a busy machine, and more by its size; a damaged one can make the library loop
HDF5_BYTES_S = 4 * 1024**2  # read in a second by the slowest disk
CHILD_BYTES = MAX_BYTES + 256 * 1024**2  # more than what is read into it, in the process that opens HDF5 and MAT files
MAX_RATIO = 200  # unpacked over packed size of a workbook; sheets of numbers reach about 10, constant columns 60
MAX_PARTS = 2000  # files in a workbook, variables, groups and datasets; two hundred sheets with pictures stay below
MAX_SHEETS = 200  # a sheet for each specimen of a large programme
MAX_SHEET_ROWS = 1_048_576  # the last row that a workbook can have
MAX_ROW_BYTES = 16 * 1024**2  # of a row or text of a workbook; 16 384 full cells take a tenth
MAX_TABLE_CELLS = 10_000_000  # of JSON and workbooks, rows x columns: each is an object of its own
MAX_BRACKETS = 3_000_000  # lists and objects of JSON, a row each
MAX_LINE = 65_536  # characters; 512 columns of 100 digits stay below
MAX_EMPTY = 100_000  # lines without a row, beyond one for each row: a doubled line end makes one, a bomb millions
MAX_WORDS = 100_000  # in a column, and half of it: a status, which is not read to its end as if it were numbers
MAX_SPECIAL = 2_000_000  # numbers with groups of thousands or D exponents; each takes a microsecond or two
MAX_CELL = 64  # characters of a number; no instrument prints more, and longer ones make pattern matching slow
MAX_VALUE = 1e30  # in any unit; no channel holds more, and its square still fits into a double
MAX_NAME = 200  # characters of a header that are looked at
MAX_DATES = 1000  # different dates in a column of time stamps; a test lasts a week at most

# --- time ---
GAP_STEPS = 3.5  # a step this many medians long is a gap: jitter and one or two lost samples stay below
JITTER_SHARE = 0.02  # 5-95 % spread of the steps over the median; clocks that print rounded times stay below
BAD_TIME_SHARE = 0.02  # more repeated or backward times than this is a broken clock, not a few broken rows
SAME_INSTANT = 0.01  # of a step: readings this near to one another are of the same time
RATE_AGREES = 0.02  # a rate that is given may differ by this share from what a time column says; clocks drift by less
# Share of the way in a gap: of 400 gaps cut into Table 1 at 10 Hz, 8 of 184 that hide a reversal pass then, and after
# 54 of the other 216 samples are left out for nothing (``test_quality.py`` cuts 200).
GAP_WAY = 0.1
MANY_GAPS_SHARE = 0.01  # more gaps than this and the median step itself means little

# --- time that begins again with each cycle of one run ---
MAX_CYCLES = 100_000  # more falls of the clock are noise
CYCLE_ROWS = 8  # of a cycle at least, and looked at on either side of its begin
CYCLE_JUMP = 0.01  # of the range, from one row to the next, beside twice what the rows around it move
CYCLE_STILL = 0.002  # of the range, in eight rows: a run ends and begins at rest where it began, a cycle in motion

# --- cells that hold no number ---
FILL_RUN = 10  # longest run of empty cells that a straight line may bridge, samples
BAD_CELL_SHARE = 0.05  # above this share of filled cells the recording is not usable

# --- rows that are no readings: a jump away from the course of a channel and one back within FILL_RUN rows ---
SPIKE_NOISE = 12.0  # standard deviations; the noise of a step is 1.4 of them
SPIKE_RANGE = 0.003  # of the range of the displacement; smaller ones harm neither reversals nor speed
SPIKE_FORCE = 0.2  # of the range of the force: 40 % of sliding; peaks of a breakaway and stick-slip stay below
SPIKE_USUAL = 4.0  # times the usual bend of the channel there, so that coarse sampling makes none
SPIKE_RETURN = 0.25  # of the jump: the device has moved on meanwhile
SPIKE_ROUNDS = 5  # searches; each finds what those before had hidden
JUMP = 3.0  # times the limit: a jump without return this large leaves no doubt
JUMP_SPEED = 10.0  # times what 95 % of the changes are below where it moves; 8 at most in public recordings
JUMP_RANGE = 0.05  # of the range of the displacement
SENTINELS = 8  # different ones in a channel
FAR = 2.5  # times the middle third of the values, or twice their median distance: five sliding forces, two strokes

# --- clipping: a run of exactly equal values AT the extreme, longer than chance and far longer than elsewhere ---
CLIP_RUN = 5
CLIP_SHARE = 0.001  # fewer clipped samples than this change nothing
CLIP_MOTION = 0.01  # displacement must go on over this share of the range while the force stays put
STOPPED_RUN = 25  # rows of one force within the range: noise does not repeat itself so often
STOPS = 3  # more such runs are a plateau, unless the rest of the channel
STOPPED_SHARE = 0.25  # is three quarters of it at least
STOPPED_EQUAL = 0.01  # and nearly all of its neighbours differ

# --- magnitude: real devices of this kind, and laboratory models of them, with room on both sides ---
MAX_FORCE_KN = 20_000.0  # the largest testing machines stop near 20 MN
MAX_STROKE_MM = 3_000.0  # the longest damper strokes are about 2 m
MIN_STROKE_MM = 0.02  # below this there is only noise
MIN_FORCE_KN = 1e-5  # 0.01 N
MAX_DURATION_S = 7 * 86_400.0  # a week

# --- the same where nobody stated the unit: sizes of tests of connections and dampers; stating the unit lifts them ---
ASSUMED_STROKE_MM = (1.0, 1_000.0)  # metres read as mm end below: a stroke of 0.19
ASSUMED_FORCE_KN = (0.1, 5_000.0)  # MN read as kN end below, newtons of most devices above
ASSUMED_SPEED_MM_S = (0.05, 5_000.0)  # mean; milliseconds read as seconds end below
LONG_TEST_S = 36_000.0  # ten hours, and slower than the above: mentioned even where the file states the unit

# --- sign, order of columns, offset, lag, cycles ---
SIGN_SHARE = 0.2  # friction dissipates: the loop area must be at least this share of (range x range), of either sign
SWAPPED_BURSTS = 1.5  # burstiness of displacement over that of force; 0.4 to 0.9 for friction, 1.3 at most measured
SWAPPED_SMOOTH = 3.0  # roughness of displacement over that of force; 1.4 at most measured, 3.6 and more where exchanged
SWAPPED_PRODUCT = 3.0  # both and the ratio of the half-cycles, where the loop gives energy back; 1.8 at most measured
SWAPPED_ROUGHNESS = 0.5  # second over first differences; driven displacements reach 0.4, noisy forces exceed 0.6
REST_SAMPLES = 10  # a rest at the start shorter than this is chance
OFFSET_SHARE = 0.10  # mean of push and pull over half their difference, from which an offset is mentioned
CENTRE_SHARE = 0.05  # middle of the stroke over the amplitude, from which it is mentioned
LAG_STEPS = 2.0  # lags below two samples cannot be told from the filter of the amplifier
LEVEL_TURNS = 8  # three half-cycles before and behind that in which the force changes
LEVEL_FACTOR = 3.0  # from one half-cycle to the next, and twice of it for two more
LEVEL_ALIKE = 1.5  # times the stroke and the duration: another amplitude or speed has another level
MIN_HALF_CYCLES = 2  # fewer cannot show both directions
FEW_HALF_CYCLES = 4  # fewer cannot show whether anything changes from cycle to cycle
MIN_SAMPLES = 32  # fewer hold less information than the law has parameters, several times over
MIN_SAMPLES_PER_HALF_CYCLE = 8  # fewer leave the elastic branch without a sample

# --- points too few to see the reversals. Eq. (1) at 0.7 Hz (10 samples in a half-cycle of Table 1) still gives K ---
FEW_RETURN = 0.25  # of the range: half-cycles that count whatever seems to be noise
FEW_APART = 5  # samples from one of their reversals to the next; with 3 a third of the reversals is missed
FEW_UNSEEN = 12  # samples in a half-cycle: with more, a force against the motion is another thing (inertia, spring)
FEW_AGAINST = 0.02  # of the samples; 0.03 and more where reversals are missed, 0 where none is
FEW_UNEVEN = 16  # samples in a half-cycle at uneven times: with 12 K is off by 9 %, with 16 it is in its interval
FEW_GAPS = 40  # the same where every other half-cycle has a gap: with 32 K is off by 2 %

# --- interpolated to a higher rate. Bends at random places are a whole number of periods apart, to a sixth of one, with
# probability 1/3; that 90 % of 40 bends are so has one below 1e-11 ---
BEND_COUNTS = 20.0  # of the resolution: rounding makes two, and ten times as much beyond a power of ten
BENDS = 40
BENDS_AGREE = 0.9
BEND_WITHIN = 1 / 6  # of a period, which the clock of the recorded samples may vary by
BEND_PERIOD = 3.0  # samples; twice the rate cannot be told from noise that was filtered
BENDS_PER_HALF_CYCLE = 4  # a drive without noise bends where it turns, and once more where the force does

# --- a channel slower than the table ---
# Counts from one reading to the next, share of the rows, and rows from one to the next, at least. Rounded noise of 10
# counts stands still in 3 % of the rows; of 3, in every tenth, but not in every third.
HELD = ((3.0, 0.05, 1.5), (10.0, 0.2, 1.19))
HELD_MOST = 32  # rows; more is a test in steps

# --- kinematics ---
REVERSAL_NOISE = 10.0  # white noise of a million samples spans 10 standard deviations peak to peak
REVERSAL_RANGE = 0.005  # share of the displacement range: rests and control hunting stay below
REVERSAL_COUNTS = 3.0  # encoder counts: a resting encoder toggles between two
BIAS_RANGE = 1e-4  # share of the range that no loop shows; a bias below it (and four times the noise) is accepted
BIAS_SHARE = 0.25  # a window is too wide when smoothing moves the curve by this share of the noise
LOCAL_SD = 4.0  # a wider window is refused where its curve leaves a narrower one by this many standard deviations
SHORTEST_SHARE = 0.2  # half-window over the shortest half-cycle: a sine keeps its peak to 0.06 % and its speed to 0.1 %
UNSURE_SD = 3.0  # standard deviations of the turning time within which a sample may lie on either side
UNSURE_SHARE = 0.1  # of the shorter neighbouring half-cycle: no more than this is ever left out
KINK_Z = 6.0  # one false alarm in 5e8 samples for white noise

# --- several runs in one file ---
RESTART_GAP_STEPS = 100  # put between runs whose clock begins again, so that nothing is smoothed across
SKETCH_SAMPLES = 20_000  # enough to see rests and strokes of some thousand half-cycles
REST_BINS = 4_000  # pieces of the duration that are looked at for movement
REST_NOISE = 50.0  # movement in such a piece over the noise, at least; 10 of these 50 are a rest
REST_SPEED = 0.05  # of the mean speed; a sine is below it for 1 % of its cycle
REST_RANGE = 0.05  # of the displacement range, from the beginning to the end of a rest; more is slow movement
REST_AT = 5.0  # standard deviations of a sample from the level of a rest
REST_HOME = 0.15  # of the displacement range: runs end where they began; rests elsewhere belong to the test
LONG_REST = 1.0  # usual half-cycles; holds at reversals are shorter, pauses between runs last minutes
SAME_STROKE = 0.05  # driven strokes of the same protocol agree to 3 % on the worst of the public rigs
PROTOCOL_HALF_CYCLES = 8  # a sequence of amplitudes shorter than this is a pattern within one run
PROTOCOL_VARIES = 1.5  # largest over smallest amplitude of a protocol that can be seen to begin again
MIN_HISTORY, MAX_HISTORY = 8, 200_000  # rows of a displacement history to be driven through: half an hour at 100 Hz
MAX_EXTRAS = 12  # further channels that a page has room for
MAX_EXTRA_NAME = 40  # characters of the name of one
CHANNEL_GAP = 0.05  # of a run, without a number: a line across is a guess where a stroke or more lies in it
CHANNEL_CELLS = 4_000  # averages of a further channel at most: tens to a half-cycle of a long test
CHANNEL_NOISE = 0.1  # of the variance of a smoothed channel: a curve over it is flatter by as much
CHANNEL_FOLLOWS = 0.5  # of the variance of a channel that the force explains: beyond it is a reaction, not a cause
