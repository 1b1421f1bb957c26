/// Writes a time series in Exodus II format: palpate_import_make_series FILE [one]. one: only the
/// first step.
#include <vtkExodusIIWriter.h>
#include <vtkNew.h>
#include <vtkTimeSourceExample.h>

int main(int argc, char** argv) {
  if (argc != 2 && argc != 3) return 2;
  vtkNew<vtkTimeSourceExample> source;  // hexahedra whose values change from step to step
  source->SetXAmplitude(0.0);
  source->SetYAmplitude(0.0);
  vtkNew<vtkExodusIIWriter> writer;
  writer->SetInputConnection(source->GetOutputPort());
  writer->SetFileName(argv[1]);
  if (argc == 2) writer->WriteAllTimeStepsOn();
  return writer->Write() == 1 ? 0 : 1;
}
