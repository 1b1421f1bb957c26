/** palpate for hosts in other languages: a scene and one hand in it, in C99. Link palpate_c.
 *
 *  Metres, seconds, newtons; right-handed axes, z up if it is up in the volume. A host's servo loop
 *  calls palpate_tick with the position of its arm, and sends the returned force. Functions that
 *  can fail report one line (what, why, remedy), cut to the size of the caller's buffer.
 */
#ifndef PALPATE_SCENES_C_API_H
#define PALPATE_SCENES_C_API_H

/* It is C: NOLINTBEGIN(modernize-*,readability-identifier-naming) */
#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/** The arm that gets the force. Start from palpate_weakest_arm(). */
typedef struct palpate_arm {
  double peak;          /**< Largest force [N], > 0. */
  double slew;          /**< Largest growth of the force [N/s], > 0. */
  double max_stiffness; /**< Largest coupling stiffness that is stable on it [N/m], > 0. */
  double max_damping;   /**< Largest coupling damping that is stable on it [N s/m], >= 0. */
  int hand;             /**< Not 0: a hand may hold it: palpate watches it and engages slowly. */
} palpate_arm;

/** The result of one tick. */
typedef struct palpate_felt {
  double force[3];  /**< Send it to the arm unchanged [N]: finite, bounded, slew-limited. */
  double proxy[3];  /**< The proxy, which a surface, stream or guide holds [m]. */
  double stiffness; /**< Stiffness of the coupling between proxy and hand [N/m]. */
  int fault; /**< Not 0: force cut until palpate_clear; palpate_fault_words has the reason. */
} palpate_felt;

/** A scene and a hand in it. */
typedef struct palpate_hand palpate_hand;

/** Returns "0.2.0". */
const char* palpate_version(void);

/** Returns limits that every desktop arm can reach, with a hand on it: 3.3 N, 500 N/m. */
palpate_arm palpate_weakest_arm(void);

/** Loads a scene file, a .vdb file or a folder of .vdb files. Slow: loads volumes.
 *  @param arm    Copied.
 *  @param rate   Ticks a second that the host will make [Hz], 10 to 100000.
 *  @param error  Gets the error line if the call fails; may be null.
 *  @return       Null if the call fails. Free it with palpate_unload. */
palpate_hand* palpate_load(const char* path, const palpate_arm* arm, double rate, char* error,
                           size_t size);

/** Loads another scene for the same hand, while another thread may tick. The running scene stays
 *  until the new one is complete, and also if the call fails. Call it from the thread that called
 *  palpate_load.
 *  @return  0, or -1 if the call fails. */
int palpate_reload(palpate_hand* hand, const char* path, char* error, size_t size);

/** Frees the hand; null has no effect. No other thread may use the hand then: send the arm zero
 *  force first. */
void palpate_unload(palpate_hand* hand);

/** Computes one tick. Real-time: no allocation, no lock, no system call. Call it from one thread at
 *  a time.
 *  @param position  Position of the hand [m]. If it stays the same to the last bit for more than
 *                   half a second, the arm counts as no longer read, and its force fades.
 *  @param age       Age of the position [s]; more than 50 ms is a fault. 0 if it is not known.
 *  @param dt        Time since the last tick [s]; a fault if 5 ms more than a period (or three
 *                   periods more, if longer), or if time does not advance as long.
 *  @param felt      Filled in.
 *  @return          felt->fault. */
int palpate_tick(palpate_hand* hand, const double position[3], double age, double dt,
                 palpate_felt* felt);

/** Cuts the force with the next tick until palpate_clear. Any thread may call it. */
void palpate_cut(palpate_hand* hand);
/** Lets the force grow again after a fault, slowly. Any thread may call it. */
void palpate_clear(palpate_hand* hand);
/** Returns the meaning of a fault and its remedy; "" for 0 and for unknown numbers. */
const char* palpate_fault_words(int fault);

/** Explains the force of a tick, as `palpate explain --json` does: the hand rests at `at` [m] and
 *  moves by `push` [m] within one tick. It uses a hand of its own, so the host's hand feels no
 *  change. Slow: loads the scene once more. Call it from the thread that called palpate_load.
 *  @param text  Gets JSON, or the error line if the call fails; cut to `size`, always terminated.
 *  @return      Length of the whole text without its terminator; minus that length if the call
 *               fails. */
long palpate_explain(palpate_hand* hand, const double at[3], const double push[3], char* text,
                     size_t size);

#ifdef __cplusplus
}
#endif
/* NOLINTEND(modernize-*,readability-identifier-naming) */

#endif
