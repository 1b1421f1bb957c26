/** The C99 interface of palpate, for host programs in any language: a scene and a hand in it. Link
 *  the library palpate_c.
 *
 *  Units are metres, seconds and newtons. The axes are right-handed; z points up if the z axis of
 *  the volume points up. The servo loop of the host calls palpate_tick with the position of its
 *  arm, and sends the returned force to the arm. A function with a text buffer writes one line
 *  (what, why, remedy) to the buffer if it fails, shortened to the size of the buffer.
 */
#ifndef PALPATE_SCENES_C_API_H
#define PALPATE_SCENES_C_API_H

/* It is C: NOLINTBEGIN(modernize-*,readability-identifier-naming) */
#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/** Limits of the arm that renders the force. Start from palpate_weakest_arm(). */
typedef struct palpate_arm {
  double peak;          /**< Largest force [N], > 0. */
  double slew;          /**< Largest growth of the force [N/s], > 0. */
  double max_stiffness; /**< Largest stable stiffness of a coupling [N/m], > 0. */
  double max_damping;   /**< Largest stable damping of a coupling [N s/m], >= 0. */
  int hand;             /**< Not 0: a hand may hold the arm: the force then engages slowly. */
} palpate_arm;

/** The result of one tick. */
typedef struct palpate_felt {
  double force[3];  /**< Force for the arm, within its limits [N]. Send it unchanged. */
  double proxy[3];  /**< Position of the proxy [m]. */
  double stiffness; /**< Stiffness of the coupling between proxy and hand [N/m]. */
  int fault;        /**< Not 0: the force is cut until palpate_clear. See palpate_fault_words. */
} palpate_felt;

/** A scene and a hand in it. */
typedef struct palpate_hand palpate_hand;

/** Returns the version of palpate, such as "0.3.0". */
const char* palpate_version(void);

/** Returns limits that all common desktop arms can render, with `hand` set: 3.3 N, 2000 N/s,
 *  500 N/m, 0.5 N s/m. */
palpate_arm palpate_weakest_arm(void);

/** Loads a scene file, a .vdb file, or a folder of .vdb files or bricks. Slow: loads volumes.
 *  @param arm    Limits of the arm; the function copies them.
 *  @param rate   Ticks per second that the host will run [Hz], 10 to 100000.
 *  @param error  Receives the error line if the call fails; may be null.
 *  @param size   Size of `error` with the terminating zero [bytes].
 *  @return       The hand, which palpate_unload frees; null if the call fails. */
palpate_hand* palpate_load(const char* path, const palpate_arm* arm, double rate, char* error,
                           size_t size);

/** Like palpate_load, for a host that ticks in virtual time, as a simulation or a test does: the
 *  time that palpate_tick takes on this machine does not count. All other faults stay, such as a
 *  large `dt`. Use this function only with a simulated arm: on a real arm, a force that comes too
 *  late must be cut. */
palpate_hand* palpate_load_virtual(const char* path, const palpate_arm* arm, double rate,
                                   char* error, size_t size);

/** Loads another scene for the same hand. The present scene stays active until the new scene is
 *  complete, and also if the call fails. If `path` is a scene file without moving volumes that
 *  differs from the present one only in strengths, isovalues or the coupling, the force stays on.
 *  Otherwise the force is zero at first, and grows again within 1.5 s. A hand inside a solid, or at
 *  a surface that yields, first has to leave the solid. A volume is read again only if the size or
 *  the time of its file has changed. Another thread may call palpate_tick at the same time.
 *  Call this function from the thread that called palpate_load.
 *  @return  0, or -1 if the call fails. */
int palpate_reload(palpate_hand* hand, const char* path, char* error, size_t size);

/** Frees the hand; null has no effect. No thread may use the hand afterwards, so send zero force to
 *  the arm before. */
void palpate_unload(palpate_hand* hand);

/** Computes one tick. Real-time: no allocation, no lock, no system call. Only one thread at a time
 *  may call this function.
 *  @param position  Position of the hand [m]. If palpate_arm::hand is set and the position is the
 *                   same to the last bit for more than half a second, the encoders count as no
 *                   longer read, and the force fades. A jump of the position is a fault, and so is
 *                   a speed above 3 m/s for more than 50 ms.
 *  @param age       Age of the position [s]; 0 if unknown. If palpate_arm::hand is set, more than
 *                   50 ms is a fault.
 *  @param dt        Time since the last tick [s]. It is a fault if `dt` exceeds the period by more
 *                   than 5 ms and by more than three periods. It is also a fault if time does not
 *                   advance for that long. If palpate_arm::hand is set, it is a fault if this call
 *                   takes that long (except after palpate_load_virtual).
 *  @param felt      Receives the result.
 *  @return          felt->fault. */
int palpate_tick(palpate_hand* hand, const double position[3], double age, double dt,
                 palpate_felt* felt);

/** Cuts the force from the next tick on, until palpate_clear. Any thread may call palpate_cut. */
void palpate_cut(palpate_hand* hand);
/** After a fault, lets the force grow again slowly. A hand inside a solid first has to leave it.
 * Any thread may call palpate_clear. */
void palpate_clear(palpate_hand* hand);
/** Returns the meaning of a fault and its remedy; "" for 0 and for an unknown number. */
const char* palpate_fault_words(int fault);

/** Explains the force of a tick as `palpate explain --json` does: a hand rests at `at` [m], and
 *  moves by `push` [m] within one tick. The function uses a separate hand and does not change
 *  `hand`. Slow: loads the scene again. Call it from the thread that called palpate_load.
 *  @param text  Receives JSON, or the error line if the call fails; shortened to `size` bytes with
 *               its terminating zero.
 *  @return      Length of the whole text without its terminator; minus that length if the call
 *               fails. */
long palpate_explain(palpate_hand* hand, const double at[3], const double push[3], char* text,
                     size_t size);

#ifdef __cplusplus
}
#endif
/* NOLINTEND(modernize-*,readability-identifier-naming) */

#endif
