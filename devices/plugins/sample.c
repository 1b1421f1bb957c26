/* A sample plug-in: two simulated arms, to be read, copied and changed (docs/plugins.md). C99 with
 * the compiler's own atomics; needs libc and libm.
 *
 * The tip of S1 is a mass on a spring and a damper about the slow path of a hand; the force moves
 * the tip. No hand holds S2, and S2 has a counterweight, so S2 passes palpate devices --test. The
 * simulation advances by the host's clock, and only when the host reads.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "plugin.h"

static const double kMass = 0.1;                /* [kg] */
static const double kSpring = 30.0;             /* [N/m] */
static const double kDamper = 2.0;              /* [N s/m] */
static const double kFriction = 1.0;            /* Friction of an arm without a hand [N s/m]. */
static const double kWeight = 0.3;              /* [N] */
static const double kPeak = 4.0;                /* [N] */
static const double kContinuous = 1.5;          /* Force that the motors can hold forever [N]. */
static const double kHeating = 20.0;            /* Time constant of the motors' heat [s]. */
static const int64_t kPeriod = 1000000;         /* Period of the positions [ns]. */
static const int64_t kWatchdog = 50000000;      /* [ns] */
static const int64_t kLongest = 200 * 1000000L; /* Longest time that one read simulates [ns]. */

/* The device comes first, so a pointer to it is also a pointer to the arm. The haptic thread uses
 * all members but `stopped`; before and after its run, the main thread uses them. */
typedef struct arm {
  palpate_plugin_device device;
  palpate_plugin_weight weight;
  palpate_plugin_heat heat;
  int open;
  int held; /* A hand holds the tip. */
  int ready;
  int stopped; /* Access only by __atomic: stop is called on any thread. */
  int64_t began;
  int64_t at; /* Time of the newest sample [ns]. */
  int64_t written;
  double force[3];
  double share, next_share; /* Share of the weight carried now, and from the next write on. */
  double hot;               /* Heat; 1: the limit. */
  double given;             /* Share of the force that the motors give. */
  double offset[3], speed[3];
} arm;

static palpate_plugin_host host;
static arm arms[2];
static const char* const kSerials[2] = {"S1", "S2"};

static size_t least(size_t a, size_t b) {
  return a < b ? a : b;
}

/* Fills in the fields for which the host's struct has room, except `size`. An older host has a
 * smaller struct, a newer host a larger one. */
static void give(void* theirs, const void* ours, size_t ours_size) {
  uint32_t size;
  memcpy(&size, theirs, sizeof size);
  if (size <= sizeof size) return;
  memcpy((char*)theirs + sizeof size, (const char*)ours + sizeof size,
         least(size, ours_size) - sizeof size);
}

/* ---- The simulated arm. A plug-in for a real arm calls its maker's library instead. ---- */

/* Computes the force of the motors and of the weight in one period. The motors give no force before
 * prepare, after a stop, and if the last write is older than kWatchdog. */
static void forceNow(arm* a, double out[3]) {
  const int off =
      __atomic_load_n(&a->stopped, __ATOMIC_ACQUIRE) || !a->ready || a->at - a->written > kWatchdog;
  double size = 0.0;
  for (int i = 0; i < 3; ++i) size += a->force[i] * a->force[i];
  size = sqrt(size);
  /* At the heat limit the motors give the force that they can hold forever. */
  a->given = a->hot >= 1.0 && size > kContinuous ? kContinuous / size : 1.0;
  for (int i = 0; i < 3; ++i) out[i] = off ? 0.0 : a->given * a->force[i];
  size = off ? 0.0 : a->given * size;
  a->hot +=
      ((size / kContinuous) * (size / kContinuous) - a->hot) * 1e-9 * (double)kPeriod / kHeating;
  if (a->held) out[2] += off ? -kWeight : (a->share - 1.0) * kWeight;
}

static void step(arm* a) {
  const double dt = 1e-9 * (double)kPeriod;
  double force[3];
  forceNow(a, force);
  for (int i = 0; i < 3; ++i) {
    const double pull = force[i] - (a->held ? kSpring * a->offset[i] + kDamper * a->speed[i]
                                            : kFriction * a->speed[i]);
    a->speed[i] += pull / kMass * dt;
    a->offset[i] += a->speed[i] * dt;
  }
  a->at += kPeriod;
}

static void measure(const arm* a, palpate_plugin_reading* r) {
  const double t = 1e-9 * (double)(a->at - a->began);
  const double w = a->held ? 0.5 : 0.0; /* [rad/s], on the hand's path, a circle of 2 cm radius. */
  r->state = a->ready ? PALPATE_PLUGIN_READY : 0;
  r->taken = a->at;
  r->position[0] = a->offset[0] + 0.02 * sin(w * t);
  r->position[1] = a->offset[1] + 0.02 * (cos(w * t) - 1.0);
  r->position[2] = a->offset[2];
  r->velocity[0] = a->speed[0] + 0.02 * w * cos(w * t);
  r->velocity[1] = a->speed[1] - 0.02 * w * sin(w * t);
  r->velocity[2] = a->speed[2];
  r->orientation[0] = cos(0.1 * t);
  r->orientation[3] = sin(0.1 * t);
  r->gripper = 0.25 * (1.0 - cos(w * t));
  /* Button 1 is pressed for one second in ten, button 2 for the next second. */
  const double second = fmod(t, 10.0);
  r->buttons = (uint32_t)(second >= 1.0 && second < 2.0) | (uint32_t)(second >= 2.0 && second < 3.0)
                                                               << 1;
}

/* ---- Functions that palpate calls. ---- */

static int facts(palpate_plugin_device* device, palpate_plugin_facts* theirs) {
  (void)device;
  palpate_plugin_facts f;
  memset(&f, 0, sizeof f);
  f.has = PALPATE_PLUGIN_FORCE | PALPATE_PLUGIN_VELOCITY | PALPATE_PLUGIN_ORIENTATION |
          PALPATE_PLUGIN_GRIPPER;
  f.force = kPeak;
  f.stiffness = 300.0;
  f.damping = 1.0;
  f.workspace_radius = 0.15;
  f.rate = 1e9 / (double)kPeriod;
  f.watchdog = 1e-9 * (double)kWatchdog;
  /* `continuous` and `heating` stay zero: the heat extension reports the heat itself. */
  f.buttons = 2;
  strcpy(f.button[0], "front");
  strcpy(f.button[1], "rear");
  strcpy(f.source, "made up: devices/plugins/sample.c");
  give(theirs, &f, sizeof f);
  return PALPATE_PLUGIN_OK;
}

static int prepare(palpate_plugin_device* device, char* error, size_t room) {
  arm* a = (arm*)device;
  /* A real arm is homed here, which may take minutes: check host.ends in between. */
  if (host.ends()) {
    snprintf(error, room, "sample: the program was ended before the arm was ready; start it again");
    return PALPATE_PLUGIN_FAILED;
  }
  memset(a->force, 0, sizeof a->force);
  a->share = a->next_share = 0.0;
  a->ready = 1;
  return PALPATE_PLUGIN_OK;
}

static int readArm(palpate_plugin_device* device, palpate_plugin_reading* theirs) {
  arm* a = (arm*)device;
  const int64_t now = host.now();
  if (now - a->at < kPeriod) return PALPATE_PLUGIN_NOTHING;
  /* Skips time after a long pause, to bound the number of steps. */
  if (now - a->at > kLongest) a->at += (now - a->at - kLongest) / kPeriod * kPeriod;
  while (now - a->at >= kPeriod) step(a);
  palpate_plugin_reading r;
  memset(&r, 0, sizeof r);
  measure(a, &r);
  give(theirs, &r, sizeof r);
  return PALPATE_PLUGIN_OK;
}

static int writeArm(palpate_plugin_device* device, const palpate_plugin_force* theirs) {
  arm* a = (arm*)device;
  palpate_plugin_force f;
  memset(&f, 0, sizeof f);
  memcpy(&f, theirs, least(theirs->size, sizeof f));
  const int zero = f.force[0] == 0.0 && f.force[1] == 0.0 && f.force[2] == 0.0;
  memcpy(a->force, f.force, sizeof a->force);
  a->share = a->next_share;
  a->written = host.now();
  /* Only a zero force ends a stop. Clears `stopped` after the zero is stored, so that no older
   * force follows. */
  if (zero) __atomic_store_n(&a->stopped, 0, __ATOMIC_RELEASE);
  return PALPATE_PLUGIN_OK;
}

static void stopArm(palpate_plugin_device* device) {
  __atomic_store_n(&((arm*)device)->stopped, 1, __ATOMIC_RELEASE);
}

static void closeArm(palpate_plugin_device* device) {
  ((arm*)device)->open = 0;
}

static void carry(palpate_plugin_device* device, double share) {
  ((arm*)device)->next_share = share;
}

static double given(palpate_plugin_device* device) {
  return ((arm*)device)->given;
}

static const void* extensionOf(palpate_plugin_device* device, const char* name) {
  const arm* a = (const arm*)device;
  if (strcmp(name, PALPATE_PLUGIN_WEIGHT) == 0) return a->held ? &a->weight : NULL;
  if (strcmp(name, PALPATE_PLUGIN_HEAT) == 0) return &a->heat;
  return NULL;
}

static int find(palpate_plugin_found* found, int room) {
  char* at = (char*)found;
  for (int i = 0; i < 2 && i < room; ++i) {
    palpate_plugin_found f;
    memset(&f, 0, sizeof f);
    strcpy(f.serial, kSerials[i]);
    strcpy(f.model, "an arm made of numbers");
    give(at, &f, sizeof f);
    /* The entries have the size that the host's version knows. */
    at += ((palpate_plugin_found*)at)->size;
  }
  return 2;
}

static palpate_plugin_device* openArm(const char* serial, char* error, size_t room) {
  int known = 0;
  for (int i = 0; i < 2; ++i) {
    if (*serial != '\0' && strcmp(serial, kSerials[i]) != 0) continue;
    known = 1;
    arm* a = &arms[i];
    if (a->open) continue;
    memset(a, 0, sizeof *a);
    const palpate_plugin_device device = {sizeof device, 0,        NULL,    facts,    prepare,
                                          readArm,       writeArm, stopArm, closeArm, extensionOf};
    const palpate_plugin_weight weight = {sizeof weight, 0, carry, 2.0};
    const palpate_plugin_heat heat = {sizeof heat, 0, given};
    a->held = i == 0;
    a->device = device;
    a->weight = weight;
    a->heat = heat;
    a->given = 1.0;
    a->began = a->at = host.now();
    a->open = 1;
    return &a->device;
  }
  if (known) {
    snprintf(error, room, "sample: that arm is open already; close it there");
  } else {
    snprintf(error, room, "sample: no arm has the serial number \"%s\"; use S1 or S2", serial);
  }
  return NULL;
}

static int init(const palpate_plugin_host* theirs) {
  memset(&host, 0, sizeof host);
  memcpy(&host, theirs, least(theirs->size, sizeof host));
  if (!host.ends || !host.now) {
    if (host.say) {
      host.say(
          "sample: this version of palpate is too old for this plug-in; install a newer palpate");
    }
    return -1;
  }
  return 0;
}

static void end(void) {}

static const palpate_plugin_factory kFactory = {sizeof kFactory, 0, find, openArm};

static const void* factory(const char* name) {
  return strcmp(name, PALPATE_PLUGIN_ARMS) == 0 ? &kFactory : NULL;
}

const palpate_plugin_entry palpate_plugin = {sizeof palpate_plugin,
                                             PALPATE_PLUGIN_MAJOR,
                                             PALPATE_PLUGIN_MINOR,
                                             0,
                                             "an arm made of numbers",
                                             "1",
                                             "as palpate's own; needs no library",
                                             init,
                                             end,
                                             factory};
