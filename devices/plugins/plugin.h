/** The interface of plug-ins, by which palpate drives arms that it does not support itself. C99.
 *
 *  A plug-in is a shared library, NAME.so, in one of palpate's plug-in folders. It exports one
 *  symbol, `palpate_plugin`, and talks to the arm through the maker's library. By default a plug-in
 *  runs in a process of its own (palpate-plugin): if the plug-in fails, that process ends and takes
 *  the force off, but the program continues.
 *
 *  Units: metres, seconds, newtons, radians. Axes: those of the hand's world W, right-handed: x to
 *  the right, y away from the user, z up, the origin in the middle of the arm's workspace.
 *
 *  Threads. Each function states where it is called:
 *  [main]    one call at a time, on the thread that called palpate_plugin.init. May wait and
 *            allocate.
 *  [haptic]  one call at a time, on the haptic thread of the process. No allocation, no file, no
 *            lock that another thread holds for longer than a tick; returns within a period.
 *  [any]     on any thread, while any other function runs, even if that function hangs.
 *
 *  Growth: every struct begins with its size, as known to the side that made the struct. The side
 *  that reads the struct treats all bytes beyond this size as zero. New fields are only added at
 *  the end, and zero means "as before". Everything else is an extension, requested by name.
 *
 *  Texts are UTF-8 and end with a zero byte. palpate checks all values from a plug-in. Numbers that
 *  are not finite, a time in the future and a quaternion of length zero are faults or count as
 *  absent; they never reach a motor.
 */
#ifndef PALPATE_DEVICES_PLUGIN_H
#define PALPATE_DEVICES_PLUGIN_H

/* It is C: NOLINTBEGIN(modernize-*,readability-identifier-naming,cppcoreguidelines-*) */
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define PALPATE_PLUGIN_MAJOR 1 /**< A plug-in of another major version is refused. */
#define PALPATE_PLUGIN_MINOR 0 /**< A plug-in may be older than its host, not newer. */

/** Results of the functions below. Any other negative number is PALPATE_PLUGIN_GONE. */
enum {
  PALPATE_PLUGIN_OK = 0,
  PALPATE_PLUGIN_NOTHING = 1, /**< read: there is no new reading. */
  PALPATE_PLUGIN_GONE = -1,   /**< The arm is unplugged, or no longer answers. */
  PALPATE_PLUGIN_FAILED = -2  /**< The arm is connected, but has refused. */
};

/** Functions that palpate offers to a plug-in. */
typedef struct palpate_plugin_host {
  uint32_t size; /**< Size of this struct [bytes]. */
  /** Prints a line for the user. Lines that come too fast are lost. [main] */
  void (*say)(const char* words);
  /** Returns nonzero after the user has ended the program: end all waits. [any] */
  int (*ends)(void);
  /** Returns CLOCK_BOOTTIME [ns]. [any] */
  int64_t (*now)(void);
  /** Returns the host's extension of this name, or null if it has none. [main] */
  const void* (*extension)(const char* name);
} palpate_plugin_host;

/** An arm that is plugged in. */
typedef struct palpate_plugin_found {
  uint32_t size;   /**< Size of this struct [bytes]. */
  char serial[64]; /**< Distinguishes arms of one kind; may be empty. */
  char model[64];  /**< Model, as text for the user. */
} palpate_plugin_found;

/** Flags of palpate_plugin_facts.has. */
enum {
  PALPATE_PLUGIN_FORCE = 1,       /**< The arm has motors. */
  PALPATE_PLUGIN_VELOCITY = 2,    /**< The arm measures velocity itself. */
  PALPATE_PLUGIN_ORIENTATION = 4, /**< The arm measures the handle's orientation. */
  PALPATE_PLUGIN_GRIPPER = 8,     /**< The arm has a gripper and measures it. */
  PALPATE_PLUGIN_DEADMAN = 16,    /**< The arm reports whether its user holds it. */
  PALPATE_PLUGIN_TORQUE = 32      /**< The arm has motors for torque; they stay at zero. */
};

/** Properties and limits of an arm: its maker's numbers, with their source. */
typedef struct palpate_plugin_facts {
  uint32_t size;           /**< Size of this struct [bytes]. */
  uint32_t has;            /**< PALPATE_PLUGIN_FORCE and other flags, or'ed. */
  double force;            /**< Largest force [N], > 0 if the arm has motors. */
  double slew;             /**< Largest growth of the force [N/s]; 0: 2000. */
  double stiffness;        /**< Largest stiffness of a coupling [N/m], > 0 if the arm has motors. */
  double damping;          /**< Largest damping of a coupling [N s/m]. */
  double workspace_radius; /**< Radius of a ball about the origin [m], > 0. */
  double rate;             /**< Positions per second [Hz], > 0. */
  double output_rate;      /**< Forces per second that the arm accepts [Hz]; 0: as `rate`. */
  double stale;            /**< Largest age of a position [s]; 0: 0.05. */
  double speed;            /**< Largest speed of a hand on the arm [m/s]; 0: 3. */
  double continuous;       /**< Force that the arm can hold forever [N]; 0: any force. */
  double heating;          /**< Time constant of the motors' heat [s]. */
  double watchdog;     /**< Time without a force after which the arm itself takes the force off [s];
                            0: never. A thread of the plug-in does not count. */
  double resolution;   /**< Position step for one encoder count [m]; 0: unknown. */
  uint32_t joints;     /**< Number of joints that the arm measures, at most 6. */
  uint32_t buttons;    /**< Number of buttons, at most 32. */
  char button[32][24]; /**< Names of the buttons; empty: "button 1" and so on. */
  char source[256];    /**< Source of the numbers above. */
} palpate_plugin_facts;

/** Flags of palpate_plugin_reading.state. */
enum {
  PALPATE_PLUGIN_READY = 1,     /**< The arm is homed and accepts a force. */
  PALPATE_PLUGIN_HELD = 2,      /**< The user holds the arm (PALPATE_PLUGIN_DEADMAN). */
  PALPATE_PLUGIN_HOT = 4,       /**< The arm is too hot. */
  PALPATE_PLUGIN_UNPOWERED = 8, /**< The motors have no power. */
  PALPATE_PLUGIN_OPEN = 16      /**< The arm's safety switch is open. */
};

/** One measurement of the hand, and the arm's state. */
typedef struct palpate_plugin_reading {
  uint32_t size;         /**< Size of this struct [bytes]. */
  uint32_t state;        /**< PALPATE_PLUGIN_READY and other flags, or'ed. */
  int64_t taken;         /**< Time of the position's measurement, by host->now [ns]. A repeated
                              position keeps its time, so that palpate detects a dead sensor. */
  double position[3];    /**< Position of the tip [m]. */
  double velocity[3];    /**< [m/s] */
  double orientation[4]; /**< Unit quaternion w, x, y, z, from the handle's axes to W. */
  double gripper;        /**< Opening angle [rad]. */
  double joints[6];      /**< [rad], or [m] for a sliding joint. */
  uint32_t buttons;      /**< Bit i: button i is pressed. */
  uint32_t zero;         /**< Reserved: zero. */
} palpate_plugin_reading;

/** A force for the motors. */
typedef struct palpate_plugin_force {
  uint32_t size;    /**< Size of this struct [bytes]. */
  uint32_t zero;    /**< Reserved: zero. */
  double force[3];  /**< Force on the hand [N]: finite, at most facts.force, grows no faster than
                         facts.slew. */
  double torque[3]; /**< Zero in this version [N m]. */
} palpate_plugin_force;

/** An open arm. The plug-in makes it, and may have more data behind these members. */
typedef struct palpate_plugin_device {
  uint32_t size; /**< Size of this struct [bytes]. */
  uint32_t zero; /**< Reserved: zero. */
  void* data;    /**< For the plug-in's own use. */

  /** Fills in the arm's facts. Called after open, before prepare, read and write. [main] */
  int (*facts)(struct palpate_plugin_device* device, palpate_plugin_facts* facts);
  /** Makes the arm ready: homes it and switches its motors on, with zero force. May take minutes;
   *  checks host->ends while it waits. A hand may be on the arm, because palpate restarts a process
   *  that has ended. So ask the user (host->say) before the arm moves. On failure writes the cause
   *  and a remedy into `error`. [main] */
  int (*prepare)(struct palpate_plugin_device* device, char* error, size_t room);
  /** Fills in the newest reading, without a wait. Returns PALPATE_PLUGIN_NOTHING if no new reading
   *  has come since the last call; palpate then ignores `reading`. `state` may change while `taken`
   *  stays. Any other number above 0 counts as PALPATE_PLUGIN_NOTHING. [haptic] */
  int (*read)(struct palpate_plugin_device* device, palpate_plugin_reading* reading);
  /** Sends a force, at the rate of the program's loop; it holds until the next one. If it cannot be
   *  sent at once, it replaces the force that waits. [haptic] */
  int (*write)(struct palpate_plugin_device* device, const palpate_plugin_force* force);
  /** Sets zero force and carries no weight, at once, even if another function runs or hangs.
   *  `write` then gives no force until it is called with zero force again. `stop` must not wait for
   *  a lock of another function: use an atomic flag. The process may end when `stop` returns, even
   *  in a crash handler. So `stop` returns when the zero has been sent or cannot be sent, within
   *  20 ms. [any] */
  void (*stop)(struct palpate_plugin_device* device);
  /** Switches the arm off and frees it. Not called while another function runs. [main] */
  void (*close)(struct palpate_plugin_device* device);
  /** Returns an extension of this device by its name, or null if it has none. [main] */
  const void* (*extension)(struct palpate_plugin_device* device, const char* name);
} palpate_plugin_device;

/** Finds and opens arms of one kind. */
typedef struct palpate_plugin_factory {
  uint32_t size; /**< Size of this struct [bytes]. */
  uint32_t zero; /**< Reserved: zero. */
  /** Fills in up to `room` plugged-in arms. The caller sets the `size` of each entry, which is also
   *  the distance to the next entry. Returns the number of arms; negative if unknown. [main] */
  int (*find)(palpate_plugin_found* found, int room);
  /** Opens an arm; an empty serial means any. Takes off a force that an ended process has left.
   *  On failure returns null and writes the cause and a remedy into `error`. [main] */
  palpate_plugin_device* (*open)(const char* serial, char* error, size_t room);
} palpate_plugin_factory;

/** The plug-in. */
typedef struct palpate_plugin_entry {
  uint32_t size;       /**< Size of this struct [bytes]. */
  uint32_t major;      /**< PALPATE_PLUGIN_MAJOR when it was compiled. */
  uint32_t minor;      /**< PALPATE_PLUGIN_MINOR when it was compiled. */
  uint32_t zero;       /**< Reserved: zero. */
  const char* name;    /**< Purpose, as text for the user. */
  const char* version; /**< Version of the plug-in. */
  const char* licence; /**< Licence of the plug-in and of the libraries that it needs. */
  /** Called before all other functions; `host` stays valid. If the plug-in cannot work, it prints
   *  the cause and does not return 0. [main] */
  int (*init)(const palpate_plugin_host* host);
  /** Called after all other functions. [main] */
  void (*end)(void);
  /** Returns a factory by its name: PALPATE_PLUGIN_ARMS; null for other names. [main] */
  const void* (*factory)(const char* name);
} palpate_plugin_entry;

/** Name of the factory that is a palpate_plugin_factory. */
#define PALPATE_PLUGIN_ARMS "palpate.arms/1"

/** Name of a device's extension, a palpate_plugin_weight: the motors can carry the arm's own weight
 *  in addition to the force. */
#define PALPATE_PLUGIN_WEIGHT "palpate.weight/1"
/** @see PALPATE_PLUGIN_WEIGHT */
typedef struct palpate_plugin_weight {
  uint32_t size; /**< Size of this struct [bytes]. */
  uint32_t zero; /**< Reserved: zero. */
  /** Sets the share of the weight that is carried from the next write on, 0 to 1. palpate raises it
   *  in steps, from 0 to 1 in half a second, and sets 0 at once. [haptic] */
  void (*carry)(palpate_plugin_device* device, double share);
  /** Largest weight at the tip in any pose [N]; > 0. An untested arm carries at most 1 N of it. */
  double most;
} palpate_plugin_weight;

/** Name of a device's extension, a palpate_plugin_heat: the arm knows the force that its motors can
 *  give at present. */
#define PALPATE_PLUGIN_HEAT "palpate.heat/1"
/** @see PALPATE_PLUGIN_HEAT */
typedef struct palpate_plugin_heat {
  uint32_t size; /**< Size of this struct [bytes]. */
  uint32_t zero; /**< Reserved: zero. */
  /** Returns the share of the last written force that the motors have given in its direction, 0 to
   *  1; less than 1 if the motors would grow too hot. [haptic] */
  double (*given)(palpate_plugin_device* device);
} palpate_plugin_heat;

/** The one symbol of a plug-in. */
#if defined(__GNUC__)
__attribute__((visibility("default")))
#endif
extern const palpate_plugin_entry palpate_plugin;

#ifdef __cplusplus
}
#endif
/* NOLINTEND(modernize-*,readability-identifier-naming,cppcoreguidelines-*) */

#endif
