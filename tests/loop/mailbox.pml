/* The protocol of engine/loop/mailbox.h, for Spin: two threads, three slots, one word.
 *
 * A value is two words that are written and read one after the other, so that a thread which is in
 * a slot while the other writes it would see halves. Checked of every interleaving of VALUES
 * publications and any number of refreshes:
 *   torn     both words of what is read are of one publication,
 *   older    what is read is never older than what was read before,
 *   lost     after the last publication a refresh finds it,
 *   shared   no slot is with both threads.
 * And that neither ever waits: no statement of either blocks (no invalid end state is reached, and
 * each loop of the reader is bounded by the check's own, not by the writer's).
 *
 * -DBREAK=1 to 3 are mistakes that the check must find: the reader takes what is not fresh; the
 * word is read and written in two steps; the fresh mark is not set.
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

/* Looks, takes what is fresh, reads both words. */
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
  /* When the writer has ended, what it published last is there. */
  (published == VALUES);
  look();
  assert(seen == VALUES)
}

/* The three slots are in three places at all times. */
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
