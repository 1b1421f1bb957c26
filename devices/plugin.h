/** The arms that palpate does not know: a plug-in's side of the contract, in C99.
 *
 *  A plug-in is a shared library, NAME.so in a folder that palpate looks into, with one symbol:
 *  `palpate_plugin`. It speaks to arms by whatever their makers' libraries are; palpate does the
 *  rest. By default it runs in a process of its own (palpate-plugin), so that what it does wrong
 *  ends that process and takes the force off, not the program.
 *
 *  Metres, seconds, newtons, radians. Right-handed axes of the hand's world W: x to the right, y
 * away from the user, z up, the origin in the middle of the arm's workspace.
 *
 *  Threads, by the words that stand at each function:
 *  [main]    one at a time, on the thread that called palpate_plugin.init. May wait and allocate.
 *  [haptic]  one at a time, on the thread that has the tick. No allocation, no lock that another
 *            thread holds for longer than a tick, no file; returns within a period.
 *  [any]     on any thread, while any other function runs, also while it hangs.
 *
 *  Growth: every struct begins with its size as its maker's compiler knew it. Whoever reads one
 *  takes what lies beyond that size as zero; fields are only added at the end, and zero means "as
 *  before". What does not fit there is an extension, asked for by name.
 *
 *  Texts are UTF-8 and end with a zero byte. What a plug-in says is checked before it is believed:
 *  numbers that are not finite, a time of the future, a quaternion of no length are faults or taken
 *  as absent, and never reach a motor.
 */
#ifndef PALPATE_DEVICES_PLUGIN_H
#define PALPATE_DEVICES_PLUGIN_H

/* It is C: NOLINTBEGIN(modernize-*,readability-identifier-naming,cppcoreguidelines-*) */
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define PALPATE_PLUGIN_MAJOR 1 /**< Another one is refused. */
#define PALPATE_PLUGIN_MINOR 0 /**< A plug-in may be older than its host, not newer. */

/** What the functions below come to. Any other negative number is PALPATE_PLUGIN_GONE. */
enum {
  PALPATE_PLUGIN_OK = 0,
  PALPATE_PLUGIN_NOTHING = 1, /**< read: nothing new has come. */
  PALPATE_PLUGIN_GONE = -1,   /**< The arm is unplugged, or does not answer any more. */
  PALPATE_PLUGIN_FAILED = -2  /**< It is there, and has refused. */
};

/** What palpate gives a plug-in. */
typedef struct palpate_plugin_host {
  uint32_t size; /**< Of this struct, in bytes. */
  /** A line for the user, as what to press; those that come too fast are lost. [main] */
  void (*say)(const char* words);
  /** Not 0: the user has ended the program, so that nothing is waited for any more. [any] */
  int (*ends)(void);
  /** CLOCK_BOOTTIME [ns]. [any] */
  int64_t (*now)(void);
  /** The host's extension of this name; null: it has none. [main] */
  const void* (*extension)(const char* name);
} palpate_plugin_host;

/** An arm that is plugged in. */
typedef struct palpate_plugin_found {
  uint32_t size;   /**< Of this struct, in bytes. */
  char serial[64]; /**< What tells it from others of its kind; empty: nothing does. */
  char model[64];  /**< Words. */
} palpate_plugin_found;

/** Flags of palpate_plugin_facts.has. */
enum {
  PALPATE_PLUGIN_FORCE = 1,       /**< It has motors. */
  PALPATE_PLUGIN_VELOCITY = 2,    /**< It measures velocity itself. */
  PALPATE_PLUGIN_ORIENTATION = 4, /**< It measures how it is held. */
  PALPATE_PLUGIN_GRIPPER = 8,     /**< It has one, and measures it. */
  PALPATE_PLUGIN_DEADMAN = 16,    /**< It says whether its user holds it. */
  PALPATE_PLUGIN_TORQUE = 32      /**< It has motors for torque: they are left at zero. */
};

/** What an arm is and may be asked for. Numbers of its maker, with their source. */
typedef struct palpate_plugin_facts {
  uint32_t size;           /**< Of this struct, in bytes. */
  uint32_t has;            /**< PALPATE_PLUGIN_FORCE and the like, or'ed. */
  double force;            /**< Largest force [N], > 0 where it has motors. */
  double slew;             /**< Largest growth of the force [N/s]; 0: 2000. */
  double stiffness;        /**< Largest stiffness of a coupling [N/m], > 0 where it has motors. */
  double damping;          /**< Largest damping of a coupling [N s/m]. */
  double workspace_radius; /**< Of a ball about the origin [m], > 0. */
  double rate;             /**< Positions a second [Hz], > 0. */
  double output_rate;      /**< Forces a second that it takes [Hz]; 0: as many as positions. */
  double stale;            /**< No position may be older [s]; 0: 0.05. */
  double speed;            /**< No hand on it may be faster [m/s]; 0: 3. */
  double continuous;       /**< What it can hold for ever [N]; 0: all. */
  double heating;          /**< Time constant of its motors' heat [s]. */
  double watchdog;     /**< The arm itself, not a thread of the plug-in, takes the force off where
                            none has come for so long [s]; 0: it never does. */
  double resolution;   /**< Step of the position for one count of its encoders [m]; 0: unknown. */
  uint32_t joints;     /**< That it measures, at most 6. */
  uint32_t buttons;    /**< At most 32. */
  char button[32][24]; /**< Their names; empty: "button 1" and so on. */
  char source[256];    /**< Where the numbers above come from. */
} palpate_plugin_facts;

/** Flags of palpate_plugin_reading.state. */
enum {
  PALPATE_PLUGIN_READY = 1,     /**< It is homed, and may be given a force. */
  PALPATE_PLUGIN_HELD = 2,      /**< Its user holds it (PALPATE_PLUGIN_DEADMAN). */
  PALPATE_PLUGIN_HOT = 4,       /**< It is too hot. */
  PALPATE_PLUGIN_UNPOWERED = 8, /**< Its motors have no power. */
  PALPATE_PLUGIN_OPEN = 16      /**< Its safety switch is open. */
};

/** Where the hand is. */
typedef struct palpate_plugin_reading {
  uint32_t size;         /**< Of this struct, in bytes. */
  uint32_t state;        /**< PALPATE_PLUGIN_READY and the like, or'ed. */
  int64_t taken;         /**< When the position was measured, by host->now [ns]. One that is read
                              again keeps its time: an arm whose sensor has died is known by it. */
  double position[3];    /**< Of the tip [m]. */
  double velocity[3];    /**< [m/s] */
  double orientation[4]; /**< Unit quaternion w, x, y, z, from the handle's axes to W. */
  double gripper;        /**< How far it is open [rad]. */
  double joints[6];      /**< [rad], of one that slides [m]. */
  uint32_t buttons;      /**< Bit i: button i is pressed. */
  uint32_t zero;         /**< Zero. */
} palpate_plugin_reading;

/** What the motors are to give. */
typedef struct palpate_plugin_force {
  uint32_t size;    /**< Of this struct, in bytes. */
  uint32_t zero;    /**< Zero. */
  double force[3];  /**< On the hand [N]: finite, at most facts.force, and grown no faster than
                         facts.slew. */
  double torque[3]; /**< Zero in this version [N m]. */
} palpate_plugin_force;

/** An arm that is open. The plug-in makes it, and may have more behind these. */
typedef struct palpate_plugin_device {
  uint32_t size; /**< Of this struct, in bytes. */
  uint32_t zero; /**< Zero. */
  void* data;    /**< The plug-in's own. */

  /** What it is. After open, before all else. [main] */
  int (*facts)(struct palpate_plugin_device* device, palpate_plugin_facts* facts);
  /** Makes it ready: homes it, switches its motors on, with zero force. May take minutes, and asks
   *  host->ends meanwhile. Where the process of a plug-in has ended it is started again, perhaps
   * with a hand on the arm: one that moves for this asks first (host->say). In `error` why it has
   * failed, with a remedy. [main] */
  int (*prepare)(struct palpate_plugin_device* device, char* error, size_t room);
  /** The newest reading, without waiting for one; PALPATE_PLUGIN_NOTHING: none since the last call;
   *  what it has written there does not count. What `state` says may change while `taken` stays.
   * Any other number that is not negative is PALPATE_PLUGIN_NOTHING. [haptic] */
  int (*read)(struct palpate_plugin_device* device, palpate_plugin_reading* reading);
  /** Sends a force, at the rate of the program's loop. It holds until the next one; one that cannot
   * be sent at once replaces what waits to be. [haptic] */
  int (*write)(struct palpate_plugin_device* device, const palpate_plugin_force* force);
  /** Zero force and no weight carried, now, whatever else goes on; write gives none after it until
   * it is called with zero force again. It takes no lock that another function holds while it
   * waits: an atomic flag. When it returns the process may end, also from a handler of a crash: it
   * returns when the zero has been sent or cannot be, within 20 ms. [any] */
  void (*stop)(struct palpate_plugin_device* device);
  /** Switches it off and frees it. Not while another function runs. [main] */
  void (*close)(struct palpate_plugin_device* device);
  /** An extension of this device by its name; null: it has none. [main] */
  const void* (*extension)(struct palpate_plugin_device* device, const char* name);
} palpate_plugin_device;

/** Finds and opens arms of a kind. */
typedef struct palpate_plugin_factory {
  uint32_t size; /**< Of this struct, in bytes. */
  uint32_t zero; /**< Zero. */
  /** Fills in up to `room` of those that are plugged in; each `size` is set by the caller, and
   *  is the way from one to the next. Returns how many there are, negative where it cannot know.
   * [main] */
  int (*find)(palpate_plugin_found* found, int room);
  /** Opens one; an empty serial is any. Takes the force off that it may have, of a process that has
   *  died. Null: in `error` why, with a remedy. [main] */
  palpate_plugin_device* (*open)(const char* serial, char* error, size_t room);
} palpate_plugin_factory;

/** The plug-in. */
typedef struct palpate_plugin_entry {
  uint32_t size;       /**< Of this struct, in bytes. */
  uint32_t major;      /**< PALPATE_PLUGIN_MAJOR as it was compiled, */
  uint32_t minor;      /**< and PALPATE_PLUGIN_MINOR. */
  uint32_t zero;       /**< Zero. */
  const char* name;    /**< What it is for, in words. */
  const char* version; /**< Its own. */
  const char* licence; /**< Of the plug-in, and of what it needs. */
  /** Before all else; `host` stays. Not 0: it cannot work, and says why. [main] */
  int (*init)(const palpate_plugin_host* host);
  /** After all else. [main] */
  void (*end)(void);
  /** What it makes, by a name: PALPATE_PLUGIN_ARMS; null for others. [main] */
  const void* (*factory)(const char* name);
} palpate_plugin_entry;

/** Name of the factory that is a palpate_plugin_factory. */
#define PALPATE_PLUGIN_ARMS "palpate.arms/1"

/** Name of a device's extension that is a palpate_plugin_weight: its motors can carry its own
 *  weight, besides the force. */
#define PALPATE_PLUGIN_WEIGHT "palpate.weight/1"
/** @see PALPATE_PLUGIN_WEIGHT */
typedef struct palpate_plugin_weight {
  uint32_t size; /**< Of this struct, in bytes. */
  uint32_t zero; /**< Zero. */
  /** From the next write on `share` of its weight is carried, 0 to 1: it is told in steps that take
   *  half a second to come in, and 0 at once. [haptic] */
  void (*carry)(palpate_plugin_device* device, double share);
  /** All of its weight is at most so many newtons at the tip, anywhere; > 0. An arm that has not
   * passed its test carries no more than 1 N of it. */
  double most;
} palpate_plugin_weight;

/** Name of a device's extension that is a palpate_plugin_heat: it knows what its motors can give
 *  just now. */
#define PALPATE_PLUGIN_HEAT "palpate.heat/1"
/** @see PALPATE_PLUGIN_HEAT */
typedef struct palpate_plugin_heat {
  uint32_t size; /**< Of this struct, in bytes. */
  uint32_t zero; /**< Zero. */
  /** The share of the last force written that its motors have given, 0 to 1, direction kept: less
   *  than 1 where they would grow too hot. [haptic] */
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
