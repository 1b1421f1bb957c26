/* The protocol of engine/loop/mailbox.h, for Spin: two threads, three slots, one shared word.
 *
 * A value has two words, which a thread writes or reads one after the other. If both threads used
 * one slot at the same time, the reader could read two different halves. Spin checks every
 * interleaving of VALUES publications and up to VALUES + 3 refreshes:
 *   torn     both words that the reader reads are of one publication,
 *   older    no value is older than the value that was read before,
 *   lost     a refresh after the last publication gives the last value,
 *   shared   no slot belongs to both threads at the same time.
 *   newest   a refresh that finds a fresh value gives the last publication or a later one.
 * No thread waits for the other: no statement of a thread blocks, except the reader's wait for the
 * last publication at the end of the test.
 *
 * -DBREAK=1 to 3 are faults that Spin must find. 1: the reader takes a value that is not fresh.
 * 2: the writer reads and writes the shared word in two steps. 3: the writer does not set FRESH.
 */
#ifndef VALUES
#define VALUES 5
#endif
#ifndef BREAK
#define BREAK 0
#endif
#define SLOT 3
#define FRESH 4

byte low[3];
byte high[3];
byte between = 2;
byte draft = 0;
byte current = 1;
byte published = 0;
byte seen = 0;

proctype writer() {
  byte n = 0;
  byte taken;
  do
  :: n < VALUES ->
     n++;
     low[draft] = n;
     high[draft] = n;
#if BREAK == 2
     taken = between;
     between = draft | FRESH;
     draft = taken & SLOT;
     published = n
#elif BREAK == 3
     atomic { taken = between; between = draft; draft = taken & SLOT; published = n }
#else
     atomic { taken = between; between = draft | FRESH; draft = taken & SLOT; published = n }
#endif
  :: else -> break
  od
}

/* Refreshes: takes the slot between the threads if it is fresh, then reads both words. */
inline look() {
#if BREAK == 1
  fresh = FRESH;
#else
  fresh = between & FRESH;
#endif
  before = published;
  if
  :: fresh -> atomic { taken = between; between = current; current = taken & SLOT }
  :: else
  fi;
  a = low[current];
  b = high[current];
  assert(a == b);
  assert(a >= seen);
  seen = a
}

proctype reader() {
  byte looks = 0;
  byte taken;
  byte fresh;
  byte before;
  byte a;
  byte b;
  do
  :: looks < VALUES + 2 -> looks++; look(); assert(!fresh || a >= before)
  :: break
  od;
  /* After the last publication, a refresh must give the last value. */
  (published == VALUES);
  look();
  assert(seen == VALUES)
}

/* Checks at all times that draft, between and current are three different slots. */
active proctype apart() {
  do
  :: atomic {
       (draft == current || draft == (between & SLOT) || current == (between & SLOT)) ->
       assert(false)
     }
  :: atomic { (published == VALUES && seen == VALUES) -> break }
  od
}

init {
  atomic { run writer(); run reader() }
}
