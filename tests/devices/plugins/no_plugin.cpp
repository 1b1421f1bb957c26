/// A library that is not a plug-in.
extern "C" __attribute__((visibility("default"))) int palpate_no_plugin() {
  return 0;
}
