/** palpate for hosts in other languages: a scene and one hand in it, in C99. Link palpate_c.
 *
 *  Metres, seconds, newtons; right-handed axes, z up where a volume's is. A host's servo loop calls
 *  palpate_tick with where its arm is, and sends the force that comes back. Functions that can fail
 *  say so in one line (what, why, remedy), cut to what the caller has room for.
 */
#ifndef PALPATE_SCENES_C_API_H
#define PALPATE_SCENES_C_API_H

/* It is C: NOLINTBEGIN(modernize-*,readability-identifier-naming) */
#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/** What the force goes to. Start from palpate_weakest_arm(). */
typedef struct palpate_arm {
  double peak;          /**< Largest force [N], > 0. */
  double slew;          /**< Largest growth of the force [N/s], > 0. */
  double max_stiffness; /**< Largest coupling stiffness that it renders stably [N/m], > 0. */
  double max_damping;   /**< Largest coupling damping that it renders stably [N s/m], >= 0. */
  int hand;             /**< Not 0: a hand may be on it: it is watched, and forces engage slowly. */
} palpate_arm;

/** What one tick came to. */
typedef struct palpate_felt {
  double force[3];  /**< To be sent to the arm as it is [N]: finite, bounded, slew-limited. */
  double proxy[3];  /**< Where the surface, stream or guide holds the proxy [m]. */
  double stiffness; /**< Of the coupling between proxy and hand [N/m]. */
  int fault; /**< Not 0: the force is cut until palpate_clear; palpate_fault_words says why. */
} palpate_felt;

/** A scene and a hand in it. */
typedef struct palpate_hand palpate_hand;

/** "0.2.0". */
const char* palpate_version(void);

/** The arm that any desktop arm is at least as strong as, with a hand on it: 3.3 N, 500 N/m. */
palpate_arm palpate_weakest_arm(void);

/** A scene file, a .vdb file or a folder of them. Slow: loads volumes.
 *  @param arm    Copied.
 *  @param rate   Ticks a second that the host will make [Hz], 10 to 100000.
 *  @param error  Takes the line where it fails; may be null.
 *  @return       Null where it fails. Free it with palpate_unload. */
palpate_hand* palpate_load(const char* path, const palpate_arm* arm, double rate, char* error,
                           size_t size);

/** Loads another scene for the same hand, while another thread may tick: the running scene stays
 *  until the new one is whole, and also where it fails. From the thread that called palpate_load.
 *  @return  0, or -1 where it fails. */
int palpate_reload(palpate_hand* hand, const char* path, char* error, size_t size);

/** Frees it; null is nothing. No other thread may use it then: send the arm zero force first. */
void palpate_unload(palpate_hand* hand);

/** One tick. Real-time: no allocation, no lock, no system call. From one thread at a time.
 *  @param position  Of the hand [m]. The same one again and again, bit by bit, for more than half a
 *                   second is an arm that is not read any more: its force fades.
 *  @param age       How old the position is [s]; more than 50 ms is a fault. 0 if it is not known.
 *  @param dt        Time since the last tick [s]; 5 ms or more (or three periods) is a fault, and
 *                   so is a time that does not go on.
 *  @param felt      Filled in.
 *  @return          felt->fault. */
int palpate_tick(palpate_hand* hand, const double position[3], double age, double dt,
                 palpate_felt* felt);

/** Cuts the force with the next tick until palpate_clear. From any thread. */
void palpate_cut(palpate_hand* hand);
/** Lets force out again after a fault, slowly. From any thread. */
void palpate_clear(palpate_hand* hand);
/** What a fault is, and what to do about it; "" for 0 and what is none. */
const char* palpate_fault_words(int fault);

/** Why the force of a tick is what it is, as `palpate explain --json` says it: the hand rests at
 *  `at` [m] and moves by `push` [m] within one tick. A hand of its own: the host's feels nothing of
 *  it. Slow: loads the scene once more. From the thread that called palpate_load.
 *  @param text  Takes JSON, or where it fails the line; cut, and always ended, if there is no room.
 *  @return      The length of all of it, without the end; negative, the same, where it fails. */
long palpate_explain(palpate_hand* hand, const double at[3], const double push[3], char* text,
                     size_t size);

#ifdef __cplusplus
}
#endif
/* NOLINTEND(modernize-*,readability-identifier-naming) */

#endif
