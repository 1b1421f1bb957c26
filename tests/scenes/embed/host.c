/* A host in C: moves a simulated hand onto a scene in virtual time, and prints the force and its
 * explanation. With an arm call palpate_load instead of palpate_load_virtual. See docs/embed.md. */
#include <palpate/scenes/bindings/c/c_api.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int main(int argc, char** argv) {
  char error[500];
  const palpate_arm arm = palpate_weakest_arm();
  palpate_hand* hand =
      palpate_load_virtual(argc > 1 ? argv[1] : "head.vdb", &arm, 1000.0, error, sizeof error);
  if (hand == NULL) {
    fprintf(stderr, "%s\n", error);
    return 2;
  }
  palpate_felt felt = {0};
  double strongest = 0.0;
  int i;
  for (i = 0; i < 3000; ++i) {
    const double position[3] = {0.0, 0.0, 0.06 - 2e-5 * i};
    if (palpate_tick(hand, position, 0.0, 1e-3, &felt) != 0) {
      printf("fault: %s\n", palpate_fault_words(felt.fault));
      break;
    }
    if (felt.force[2] > strongest) strongest = felt.force[2];
  }
  printf("palpate %s: at most %.2f N\n", palpate_version(), strongest);

  {
    const double at[3] = {0.0, 0.0, 0.03};
    const double push[3] = {0.0, 0.0, -0.001};
    const long length = palpate_explain(hand, at, push, NULL, 0);
    char* json = malloc((size_t)labs(length) + 1);
    if (json != NULL && palpate_explain(hand, at, push, json, (size_t)labs(length) + 1) > 0) {
      printf("why: %.60s...\n", json);
    }
    free(json);
  }
  /* A scene that cannot be loaded is refused. The current scene stays active. */
  if (palpate_reload(hand, "no_such.vdb", error, sizeof error) != 0) printf("%s\n", error);
  palpate_unload(hand);
  return strongest > 0.1 ? 0 : 1;
}
